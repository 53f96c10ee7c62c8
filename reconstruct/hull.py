"""The visual hull: cells of the object's box that no mask rules out. What is outside is never looked at again."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from datasets.scene import View
from reconstruct.rays import Normalisation, Pixels, scaled_camera
from reconstruct.sampling.occupancy import _centres


def possible_cells(
    pixels: Pixels, views: tuple[View, ...], normalisation: Normalisation, grid: int, scale: float
) -> NDArray[np.bool_] | None:
    """(grid^3,) True for cells of the cube that every mask allows; None where all pixels belong to the object.

    A cell is ruled out by a view where no pixel within its projected size belongs to the object. Cells outside a view's
    picture, or behind it, are not ruled out by it.
    """
    alpha = np.asarray(pixels.colour[:, 3])
    if (alpha > 0.99).all():
        return None
    ends = np.cumsum([scaled_camera(view, scale).width * scaled_camera(view, scale).height for view in views])
    masks = np.split(alpha > 0.01, ends[:-1])
    centres = _centres(grid, 1.0) / normalisation.scale + normalisation.centre
    half_diagonal = np.sqrt(3) / grid / normalisation.scale
    alive = np.arange(len(centres))
    for index in np.random.default_rng(0).permutation(len(views)):  # views far apart rule out most, soonest
        view = views[index]
        camera = scaled_camera(view, scale)
        rotation, position = view.world_from_camera[:3, :3], view.world_from_camera[:3, 3]
        points = (centres[alive] - position) @ rotation
        depth = points[:, 2]
        nearest = max(depth.min(initial=np.inf), 1e-6)
        reach = int(np.ceil(half_diagonal * camera.fx / nearest)) + 1
        mask = maximum_filter(masks[index].reshape(camera.height, camera.width), size=2 * min(reach, 32) + 1)
        pixels = camera.project(np.where(depth[:, None] > 1e-6, points, [0, 0, 1.0])) if len(points) else np.zeros((0, 2))
        column, row = np.floor(np.clip(pixels, -1e6, 1e6)).astype(int).T
        seen = (depth > 1e-6) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        keep = np.ones(len(alive), bool)
        keep[seen] = mask[row[seen], column[seen]]
        alive = alive[keep]
    possible = np.zeros(len(centres), bool)
    possible[alive] = True
    return possible
