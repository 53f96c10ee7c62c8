"""Which way is up in a model: by printed markers that lie flat, by the plane of a table or floor, or by the cameras.

Photographs are held level more often than not: their horizontal axes are horizontal in the world. That is the rough guide; the
largest plane across it is taken as the ground where enough points lie in one.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.process.pictures.markers import PlacedMarker
from koala3d.datasets.scene import View

Array = NDArray[np.float64]

KINDS = ("auto", "marker", "plane", "cameras", "none")
ROLL, PITCH = np.deg2rad(3.0), np.deg2rad(20.0)
"""Standard deviations of how far a picture is from level, and of the mean upward axis of all from the vertical [rad]."""
TILT_DEG = 25.0
"""Largest angle between the ground's normal and what the cameras, or printed markers among themselves, say."""
THICKNESS = 0.01
"""Half the thickness of a plane, in median distances of the points from their middle."""
SHARE = 0.12
"""Smallest share of the points in the ground."""
TRIALS = 2000


def by_cameras(views: Sequence[View]) -> Array:
    """(3,) unit vector across the horizontal axes of the pictures and near their mean upward axis, as errors of both allow.

    It is the mode of a Gaussian: the mean upward axis m is off by `PITCH`, and each horizontal axis r by `ROLL`, so that
    (I / PITCH^2 + sum of r r^T / ROLL^2) u = m / PITCH^2.
    """
    axes = np.stack([view.world_from_camera[:3, :2] for view in views])
    right, mean_up = axes[:, :, 0], -axes[:, :, 1].mean(0)
    up = np.linalg.solve(np.eye(3) + right.T @ right * (PITCH / ROLL) ** 2, mean_up)
    length = np.linalg.norm(up)
    return up / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])


def by_plane(views: Sequence[View], points: Array, guide: Array, *, seed: int = 0) -> tuple[Array, Array, float] | None:
    """The ground: (3,) normal towards the cameras, (3,) a point in it, the share of the points there. None where there is none.

    RANSAC (Fischler and Bolles 1981) over planes whose normal is near `guide`, with all cameras above them.
    """
    random = np.random.default_rng(seed)
    middle = np.median(points, axis=0)
    thickness = THICKNESS * float(np.median(np.linalg.norm(points - middle, axis=1)))
    cameras = np.stack([view.world_from_camera[:3, 3] for view in views])
    best: tuple[int, Array, Array] | None = None
    corners = points[random.integers(len(points), size=(TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 1e-12, normals / np.maximum(lengths, 1e-12), 0.0)
    normals *= np.where(normals @ guide >= 0, 1.0, -1.0)[:, None]
    for normal, place in zip(normals, corners[:, 0], strict=True):
        if normal @ guide < np.cos(np.deg2rad(TILT_DEG)) or ((cameras - place) @ normal).min() <= 0:
            continue
        inside = int((np.abs((points - place) @ normal) < thickness).sum())
        if best is None or inside > best[0]:
            best = inside, normal, place
    if best is None or best[0] < SHARE * len(points):
        return None
    return _fitted(points, best[1], best[2], thickness)


def _fitted(points: Array, normal: Array, place: Array, thickness: float) -> tuple[Array, Array, float]:
    """The plane through the points near a first guess, in the least-squares sense, on the same side."""
    for _ in range(5):
        near = points[np.abs((points - place) @ normal) < thickness]
        place = near.mean(0)
        direction = np.linalg.svd(near - place, full_matrices=False)[2][2]
        normal = direction * (1.0 if direction @ normal >= 0 else -1.0)
    share = float((np.abs((points - place) @ normal) < thickness).mean())
    return normal, place, share


def by_markers(placed: Sequence[PlacedMarker]) -> tuple[Array, str] | None:
    """(3,) mean normal of the markers, and the evidence; None where there is none, or they face different ways."""
    if not placed:
        return None
    normals = np.stack([marker.normal for marker in placed])
    mean = normals.mean(0) / max(np.linalg.norm(normals.mean(0)), 1e-12)
    if (normals @ mean).min() < np.cos(np.deg2rad(TILT_DEG)):
        return None
    return mean, f"the normal of {len(placed)} printed markers" if len(placed) > 1 else "the normal of a printed marker"
