"""The visual hull: cells of the object's box that no mask rules out. What is outside is never looked at again."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from datasets.scene import View
from reconstruct.rays import Normalisation, read_scaled, scaled_camera
from reconstruct.sampling.occupancy import _centres


def possible_cells(views: tuple[View, ...], normalisation: Normalisation, grid: int, scale: float) -> NDArray[np.bool_] | None:
    """(grid^3,) True for cells of the cube that every mask allows; None where the views carry no alpha.

    A cell is ruled out by a view where no pixel within its projected size belongs to the object. Cells outside a view's
    picture, or behind it, are not ruled out by it.
    """
    centres = _centres(grid, 1.0) / normalisation.scale + normalisation.centre
    half_diagonal = np.sqrt(3) / grid / normalisation.scale
    alive = np.arange(len(centres))
    for view in views:
        picture = read_scaled(view, scale)
        if picture.shape[-1] not in (2, 4):
            return None
        camera = scaled_camera(view, scale)
        rotation, position = view.world_from_camera[:3, :3], view.world_from_camera[:3, 3]
        points = (centres[alive] - position) @ rotation
        depth = points[:, 2]
        nearest = max(depth.min(initial=np.inf), 1e-6)
        reach = int(np.ceil(half_diagonal * camera.fx / nearest)) + 1
        mask = maximum_filter(picture[..., -1] > 0.01, size=2 * min(reach, 32) + 1)
        pixels = camera.project(np.where(depth[:, None] > 1e-6, points, [0, 0, 1.0])) if len(points) else np.zeros((0, 2))
        column, row = np.floor(np.clip(pixels, -1e6, 1e6)).astype(int).T
        seen = (depth > 1e-6) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        keep = np.ones(len(alive), bool)
        keep[seen] = mask[row[seen], column[seen]]
        alive = alive[keep]
    possible = np.zeros(len(centres), bool)
    possible[alive] = True
    return possible
