"""A target that is not the flat print that it is taken for: stretched by its printer, bent by its plate.

Printers feed paper by a roller: lengths along x and y are off by different shares. Plates sag or arch: to second order the middle
lies above the edges, along x and along y. With (u, v) the place on the target, -1 to 1 from edge to edge, a corner is at

    (x (1 + shape[0]),  y (1 + shape[1]),  z + shape[2] (1 - u^2) + shape[3] (1 - v^2)).

This is linear in `shape`. A twist of the plate, u v, is left out. Since the arm measures in metres, the stretch is observable,
and the focal length does not absorb it. The same form of bending: mrcal (Kogan), "calobject_warp".
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets.residuals import Residuals

if TYPE_CHECKING:
    from koala3d.calib.handeye.model import Measurements
    from koala3d.calib.handeye.refine import Refined

NAMES = (
    "stretch of the target along x",
    "stretch of the target along y",
    "sag of the target along x",
    "sag of the target along y",
)
FLAT = np.zeros(4)


def extent_of(points: Array) -> Array:
    """(2, 2) smallest and largest x and y of (n, 3) printed points [m]."""
    return np.stack([points[:, :2].min(0), points[:, :2].max(0)])


def by_shape(points: Array, extent: Array) -> Array:
    """(n, 3, 4) derivatives of (n, 3) points by `shape`."""
    low, high = extent
    place = 2 * (points[:, :2] - low) / np.maximum(high - low, 1e-9) - 1
    found = np.zeros((len(points), 3, 4))
    found[:, 0, 0], found[:, 1, 1] = points[:, 0], points[:, 1]
    found[:, 2, 2:] = 1 - place**2
    return found


def facts(measured: "Measurements", refined: "Refined", covariance: Array) -> dict[str, Any]:
    """For the calibration file: the shape with its standard deviations, 0 where it was not estimated. Nothing if none was."""
    if not measured.shaped:
        return {}
    std, before = np.zeros(4), len(measured.free) + len(measured.erring)
    std[measured.shaped] = np.sqrt(np.diag(covariance))[before : before + len(measured.shaped)]
    return {"target_shape": refined.state.shape.tolist(), "target_shape_std": std.tolist()}


def known(residuals: Residuals) -> Array:
    """(4,) shape from a calibration file; flat if it holds none."""
    found = np.asarray(residuals.target_shape or FLAT, np.float64)
    return found if found.shape == (4,) and np.isfinite(found).all() else FLAT


def in_words(residuals: Residuals) -> str:
    """One line of what was found; empty if nothing was estimated."""
    std = np.asarray(residuals.target_shape_std or FLAT)
    shape, parts = known(residuals), []
    if std[:2].any():
        stretch = " and ".join(f"{100 * one:.3f} ± {100 * s:.3f} %" for one, s in zip(shape[:2], std[:2], strict=True))
        parts.append(f"stretched by {stretch} along x and y")
    if std[2:].any():
        sag = " and ".join(f"{1e3 * one:.3f} ± {1e3 * s:.3f} mm" for one, s in zip(shape[2:], std[2:], strict=True))
        parts.append(f"its middle {sag} deeper than its edges along x and y")
    return ", ".join(parts)
