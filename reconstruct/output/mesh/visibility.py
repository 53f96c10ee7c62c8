"""What sees a surface that is covered with points: cameras, and directions far away. Depth maps of the points decide."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from koala3d.datasets.scene import View
from koala3d.reconstruct.output.mesh.surface_distance import seen_by

GRAZING = 0.1
"""Cosine between normal and direction below which a point counts as turned away: depth maps cannot tell there."""
DIRECTIONS = 192
"""Directions over the sphere from which light is let in: 15 degrees apart."""
DENSITY = 1.5
"""Width of a depth map's cell in mean distances of the points."""


def seen_from(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], views: tuple[View, ...]
) -> Iterator[tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n 3"]]]:
    """For each view, which points it sees, and the unit directions of its rays to all points (world frame)."""
    for view in views:
        rays = points - view.world_from_camera[:3, 3]
        rays = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)
        yield seen_by(points, view) & (np.sum(rays * normals, -1) < -GRAZING), rays


def open_to(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], towards: Float[np.ndarray, "m 3"]
) -> Bool[np.ndarray, "m n"]:
    """Whether nothing of the surface is before a point in each of the given unit directions.

    Args:
        points: spread evenly over the surface; about one in each cell of a depth map, or more.
    """
    area = 6 * np.prod(np.maximum(np.ptp(points, axis=0), 1e-9)) ** (2 / 3)  # of the box around them: more than the surface's
    cell = DENSITY * np.sqrt(area / len(points))
    found = np.zeros((len(towards), len(points)), bool)
    for row, direction in zip(found, towards, strict=True):
        cosine = normals @ direction
        facing = np.flatnonzero(cosine > GRAZING)
        row[facing] = _unobstructed(points, direction, cell)[facing] >= -cell * (1 + 2.2 / cosine[facing])
    return found


def _unobstructed(points: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, " 3"], cell: float) -> Float[np.ndarray, " n"]:
    """How far points are before (negative: behind) the nearest surface at their place in a picture along a direction."""
    from scipy.ndimage import maximum_filter

    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    across = across / np.linalg.norm(across)
    plane = np.stack([points @ across, points @ np.cross(direction, across)], -1)
    column, row = np.floor((plane - plane.min(0)) / cell).astype(np.int64).T
    width, height = int(column.max()) + 1, int(row.max()) + 1
    level = points @ direction
    nearest = np.full(width * height, -np.inf)
    np.maximum.at(nearest, row * width + column, level)
    nearest = maximum_filter(nearest.reshape(height, width), 3, mode="constant", cval=-np.inf)
    return level - nearest[row, column]
