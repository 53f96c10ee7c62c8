"""Projection with its analytic derivatives: the camera of `datasets.camera_model` on flat arrays.

Intrinsics travel as a (12,) vector in the order of `NAMES`. Symbols: x, y ideal normalised coordinates, r2 = x*x + y*y.
"""

from dataclasses import replace

import numpy as np

from calib.arrays import Array
from datasets.camera_model import Camera, fisheye_radial

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def vector(camera: Camera) -> Array:
    """(12,) intrinsics of a camera."""
    return np.array([getattr(camera, name) for name in NAMES])


def with_vector(camera: Camera, intrinsics: Array) -> Camera:
    """`camera` with (12,) other intrinsics."""
    return replace(camera, **dict(zip(NAMES, map(float, intrinsics), strict=True)))


def project(points: Array, intrinsics: Array, fisheye: bool = False) -> tuple[Array, Array, Array]:
    """Pixels of points and how they change.

    Args:
        points: (n, 3) in the camera frame [m], z > 0.
        intrinsics: (12,).
        fisheye: whether k1 k2 k3 k4 are those of a fisheye lens.

    Returns:
        (n, 2) pixels, (n, 2, 3) derivative by the point [px / m], (n, 2, 12) derivative by the intrinsics.
    """
    fx, fy, cx, cy, p1, p2 = (intrinsics[NAMES.index(name)] for name in ("fx", "fy", "cx", "cy", "p1", "p2"))
    inverse_z = 1 / points[:, 2]
    x, y = points[:, 0] * inverse_z, points[:, 1] * inverse_z
    r2 = x * x + y * y
    radial, slope, by_coefficient = (_fisheye if fisheye else _polynomial)(r2, intrinsics)
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y

    xx = fx * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x)  # d u / d x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # d distorted x / d y = d distorted y / d x
    yy = fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)  # d v / d y
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1], by_point[:, 0, 2] = xx, fx * xy, -(xx * x + fx * xy * y)
    by_point[:, 1, 0], by_point[:, 1, 1], by_point[:, 1, 2] = fy * xy, yy, -(fy * xy * x + yy * y)
    by_point *= inverse_z[:, None, None]

    by_intrinsics = np.zeros((len(points), 2, len(NAMES)))
    by_intrinsics[:, 0, 0], by_intrinsics[:, 1, 1] = distorted_x, distorted_y
    by_intrinsics[:, 0, 2] = by_intrinsics[:, 1, 3] = 1.0
    for name, change in by_coefficient.items():
        column = NAMES.index(name)
        by_intrinsics[:, 0, column], by_intrinsics[:, 1, column] = fx * x * change, fy * y * change
    by_intrinsics[:, 0, 6], by_intrinsics[:, 1, 6] = 2 * fx * x * y, fy * (r2 + 2 * y * y)
    by_intrinsics[:, 0, 7], by_intrinsics[:, 1, 7] = fx * (r2 + 2 * x * x), 2 * fy * x * y
    pixels = np.stack([fx * distorted_x + cx, fy * distorted_y + cy], -1)
    return pixels, by_point, by_intrinsics


def _polynomial(r2: Array, intrinsics: Array) -> tuple[Array, Array, dict[str, Array]]:
    """(n,) radial factor, its derivative by r2, and by each coefficient."""
    k1, k2, k3, k4, k5, k6 = (intrinsics[NAMES.index(name)] for name in ("k1", "k2", "k3", "k4", "k5", "k6"))
    above, slope_above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + r2 * 3 * k3)
    below, slope_below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6)), k4 + r2 * (2 * k5 + r2 * 3 * k6)
    powers = (r2, r2 * r2, r2**3)
    changes = {f"k{i}": power / below for i, power in enumerate(powers, 1)}
    changes |= {f"k{i}": -power * above / below**2 for i, power in enumerate(powers, 4)}
    return above / below, (slope_above * below - above * slope_below) / below**2, changes


def _fisheye(r2: Array, intrinsics: Array) -> tuple[Array, Array, dict[str, Array]]:
    """The same for a fisheye."""
    names = ("k1", "k2", "k3", "k4")
    radial, slope = fisheye_radial(r2, [intrinsics[NAMES.index(name)] for name in names])
    r = np.sqrt(r2)
    angle = np.arctan(r)
    share = angle / np.maximum(r, 1e-12)
    return radial, slope, {name: share * angle ** (2 * power) for power, name in enumerate(names, 1)}
