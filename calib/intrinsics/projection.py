"""Projection with its analytic derivatives: the camera of `datasets.camera_model` on flat arrays.

Intrinsics travel as a (12,) vector in the order of `NAMES`; those of a splined lens as a (12 + 2 knots,) one, with the knots
behind, x before y. Symbols: x, y ideal normalised coordinates, r2 = x*x + y*y.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets.camera_model import Camera, fisheye_radial
from koala3d.datasets.spline import Grid, Spline

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


@dataclass(frozen=True)
class Form:
    """What a lens is beside its numbers."""

    fisheye: bool = False
    """Whether k1 k2 k3 k4 are those of a fisheye lens."""
    grid: Grid | None = None
    """The knots of a splined lens."""


PLAIN = Form()


def form(camera: Camera) -> Form:
    """The form of a camera's lens."""
    return Form(camera.fisheye, None if camera.spline is None else camera.spline.grid)


def knot_names(grid: Grid | None) -> tuple[str, ...]:
    """Names of the displacements of all knots, in the order of the vector; none without a grid."""
    return tuple(f"{_KNOT}{number} {axis}" for number in range(grid.count if grid else 0) for axis in "xy")


def is_knot(name: str) -> bool:
    """True for a name of `knot_names`."""
    return name.startswith(_KNOT)


def columns(names: Sequence[str]) -> list[int]:
    """Indices of intrinsics in the vector."""
    return [_knot_column(name) if is_knot(name) else NAMES.index(name) for name in names]


_KNOT = "knot "


def _knot_column(name: str) -> int:
    number, axis = name.removeprefix(_KNOT).split()
    return len(NAMES) + 2 * int(number) + "xy".index(axis)


def vector(camera: Camera) -> Array:
    """Intrinsics of a camera."""
    numbers = np.array([getattr(camera, name) for name in NAMES])
    return numbers if camera.spline is None else np.concatenate([numbers, camera.spline.knots])


def with_vector(camera: Camera, intrinsics: Array) -> Camera:
    """`camera` with other intrinsics, those of its knots among them where it has some."""
    found = replace(camera, **dict(zip(NAMES, map(float, intrinsics), strict=False)))
    if camera.spline is None:
        return found
    return replace(found, spline=Spline(camera.spline.grid, tuple(map(float, intrinsics[len(NAMES) :]))))


def project(points: Array, intrinsics: Array, form: Form = PLAIN) -> tuple[Array, Array, Array]:
    """Pixels of points and how they change.

    Args:
        points: (n, 3) in the camera frame [m], z > 0.
        intrinsics: (k,) of a lens of this `form`.

    Returns:
        (n, 2) pixels, (n, 2, 3) derivative by the point [px / m], (n, 2, k) derivative by the intrinsics.
    """
    by_formula = _by_formula(points, intrinsics[: len(NAMES)], form.fisheye)
    return by_formula if form.grid is None else _splined(form.grid, intrinsics, *by_formula)


def _splined(grid: Grid, intrinsics: Array, pixels: Array, by_point: Array, by_intrinsics: Array) -> tuple[Array, Array, Array]:
    """`project` with knots, from what the formula alone gives.

    With q the place by the formula and s the surface, pixel = f (q + s(q)) + c. So what moves q by dq moves the pixel by
    f (1 + ds/dq) dq.
    """
    focal, centre, knots = intrinsics[:2], intrinsics[2:4], intrinsics[len(NAMES) :].reshape(-1, 2)
    places = (pixels - centre) / focal
    moved, slope = grid.surface(places, knots)
    more = slope * focal[:, None] / focal  # in pixels by pixels
    by_numbers = by_intrinsics.copy()
    by_numbers[..., 4:] += more @ by_intrinsics[..., 4:]
    by_numbers[:, 0, 0] += moved[:, 0]
    by_numbers[:, 1, 1] += moved[:, 1]
    by_knots = grid.weights(places)[:, None, :, None] * np.diag(focal)[:, None, :]
    found = np.concatenate([by_numbers, by_knots.reshape(len(pixels), 2, -1)], -1)
    return pixels + focal * moved, by_point + more @ by_point, found


def _by_formula(points: Array, intrinsics: Array, fisheye: bool) -> tuple[Array, Array, Array]:
    """`project` without knots."""
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
