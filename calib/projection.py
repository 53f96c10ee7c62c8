"""Projection with its analytic derivatives: the camera of `datasets.camera_model` on flat arrays.

Intrinsics travel as a (9,) vector in the order of `NAMES`. Symbols: x, y ideal normalised coordinates, r2 = x*x + y*y.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from datasets.camera_model import Camera

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
Array = NDArray[np.float64]


def vector(camera: Camera) -> Array:
    """(9,) intrinsics of a camera."""
    return np.array([getattr(camera, name) for name in NAMES])


def with_vector(camera: Camera, intrinsics: Array) -> Camera:
    """`camera` with (9,) other intrinsics."""
    return replace(camera, **dict(zip(NAMES, map(float, intrinsics), strict=True)))


def project(points: Array, intrinsics: Array) -> tuple[Array, Array, Array]:
    """Pixels of points and how they change.

    Args:
        points: (n, 3) in the camera frame [m], z > 0.
        intrinsics: (9,).

    Returns:
        (n, 2) pixels, (n, 2, 3) derivative by the point [px / m], (n, 2, 9) derivative by the intrinsics.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    inverse_z = 1 / points[:, 2]
    x, y = points[:, 0] * inverse_z, points[:, 1] * inverse_z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # d radial / d r2
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y

    xx = fx * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x)  # d u / d x
    xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y  # d distorted x / d y = d distorted y / d x
    yy = fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)  # d v / d y
    by_point = np.empty((len(points), 2, 3))
    by_point[:, 0, 0], by_point[:, 0, 1], by_point[:, 0, 2] = xx, fx * xy, -(xx * x + fx * xy * y)
    by_point[:, 1, 0], by_point[:, 1, 1], by_point[:, 1, 2] = fy * xy, yy, -(fy * xy * x + yy * y)
    by_point *= inverse_z[:, None, None]

    by_intrinsics = np.zeros((len(points), 2, 9))
    by_intrinsics[:, 0, 0], by_intrinsics[:, 1, 1] = distorted_x, distorted_y
    by_intrinsics[:, 0, 2] = by_intrinsics[:, 1, 3] = 1.0
    for column, power in ((4, r2), (5, r2 * r2), (8, r2**3)):
        by_intrinsics[:, 0, column], by_intrinsics[:, 1, column] = fx * x * power, fy * y * power
    by_intrinsics[:, 0, 6], by_intrinsics[:, 1, 6] = 2 * fx * x * y, fy * (r2 + 2 * y * y)
    by_intrinsics[:, 0, 7], by_intrinsics[:, 1, 7] = fx * (r2 + 2 * x * x), 2 * fy * x * y
    pixels = np.stack([fx * distorted_x + cx, fy * distorted_y + cy], -1)
    return pixels, by_point, by_intrinsics
