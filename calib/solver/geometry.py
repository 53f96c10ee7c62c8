"""Small rotations and cross products on flat arrays of vectors."""

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.datasets import pose


def rotate(rotations: Array, points: Array) -> Array:
    """(n, 3) points, each turned by its own of (n, 3, 3) matrices."""
    return np.einsum("nij,nj->ni", rotations, points)


def rows_cross(rows: Array, points: Array) -> Array:
    """(n, 2, 3) rows @ cross(points), for (n, 2, 3) rows and (n, 3) points."""
    x, y, z = (points[:, None, axis] for axis in range(3))
    a, b, c = rows[..., 0], rows[..., 1], rows[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], -1)


def by_motion(by_points: Array, points: Array) -> Array:
    """(n, 2, 6) derivative by a small motion of (n, 3) points (translation, then rotation), from that (n, 2, 3) by the points."""
    return np.concatenate([by_points, -rows_cross(by_points, points)], -1)


def exponential(vectors: Array) -> tuple[Array, Array]:
    """(n, 3, 3) rotations of (n, 3) rotation vectors and their right Jacobians (Sola et al. 2018, eq. 143)."""
    angle2 = np.sum(vectors**2, -1)[:, None, None]
    safe = np.where(angle2 > 1e-8, angle2, 1.0)
    angle = np.sqrt(safe)
    skew = pose.cross(vectors)
    sine = np.where(angle2 > 1e-8, np.sin(angle) / angle, 1 - angle2 / 6)
    cosine = np.where(angle2 > 1e-8, (1 - np.cos(angle)) / safe, 0.5 - angle2 / 24)
    cubic = np.where(angle2 > 1e-8, (angle - np.sin(angle)) / (safe * angle), 1 / 6 - angle2 / 120)
    square = skew @ skew
    return np.eye(3) + sine * skew + cosine * square, np.eye(3) - cosine * skew + cubic * square
