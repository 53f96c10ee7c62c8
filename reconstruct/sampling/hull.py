"""Cells that can hold anything: the masks' visual hull around the object, and what several cameras see around it.

What is ruled out here is never looked at again.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from datasets.scene import View
from reconstruct.sampling.occupancy import cell_centres
from reconstruct.scene.rays import Normalisation, Pixels, scaled_camera


def cells_in_masks(
    pixels: Pixels,
    views: tuple[View, ...],
    normalisation: Normalisation,
    grid: int,
    scale: float,
    *,
    slack: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.bool_] | None:
    """(grid^3,) True for cells of the cube that every mask allows; None where all pixels belong to the object.

    A cell is ruled out by a view where no pixel within its projected size belongs to the object. Cells outside a view's
    picture, or behind it, are not ruled out by it.

    Args:
        slack: how far cameras may be from where the views have them [scene unit], and turned [rad].
    """
    alpha = np.asarray(pixels.colour[:, 3])
    if (alpha > 0.99).all():
        return None
    ends = np.cumsum([scaled_camera(view, scale).width * scaled_camera(view, scale).height for view in views])
    masks = np.split(alpha > 0.01, ends[:-1])
    centres = cell_centres(grid, 1.0) / normalisation.scale + normalisation.centre
    half_diagonal = np.sqrt(3) / grid / normalisation.scale
    alive = np.arange(len(centres))
    for index in np.random.default_rng(0).permutation(len(views)):  # views far apart rule out most, soonest
        view = views[index]
        camera = scaled_camera(view, scale)
        rotation, position = view.world_from_camera[:3, :3], view.world_from_camera[:3, 3]
        points = (centres[alive] - position) @ rotation
        depth = points[:, 2]
        nearest = max(depth.min(initial=np.inf), 1e-6)
        margin = int(np.ceil((slack[0] / normalisation.scale / nearest + slack[1]) * camera.fx))
        reach = int(np.ceil(half_diagonal * camera.fx / nearest)) + 1 + margin
        mask = maximum_filter(masks[index].reshape(camera.height, camera.width), size=2 * min(reach, 32) + 1)
        projected = camera.project(np.where(depth[:, None] > 1e-6, points, [0, 0, 1.0])) if len(points) else np.zeros((0, 2))
        column, row = np.floor(np.clip(projected, -1e6, 1e6)).astype(int).T
        shown = (
            (depth > 1e-6)
            & (np.minimum(column, row) >= margin)
            & (column < camera.width - margin)
            & (row < camera.height - margin)
        )
        keep = np.ones(len(alive), bool)
        keep[shown] = mask[row[shown], column[shown]]
        alive = alive[keep]
    possible = np.zeros(len(centres), bool)
    possible[alive] = True
    return possible


def cells_in_sight(views: tuple[View, ...], normalisation: Normalisation, grid: int, needed: int = 3) -> NDArray[np.bool_]:
    """(grid^3,) True for cells of the surroundings that cameras can place.

    All that any camera sees of a common frustum. Around an object: nearer than the furthest camera, a cell must be in the picture of `needed` cameras: what fewer see cannot be
    triangulated, and would only be a cloud before a lens. Further out, one camera is enough.
    """
    if normalisation.frustum is not None:
        mapped = cell_centres(grid, 1.0)
        deep = np.abs(mapped[:, 2]) < normalisation.frustum.deep + 1 / grid
        return deep & (views_of(views, normalisation, normalisation.frustum.scene_points(mapped)) > 0)
    contracted = cell_centres(grid, 2.0)
    radius = np.linalg.norm(contracted, axis=-1, keepdims=True)
    outward = contracted / np.maximum(radius, 1e-9)
    scene = np.where(radius > 1, outward / np.maximum(2 - radius, 1e-3), contracted)
    positions = np.stack([view.world_from_camera[:3, 3] for view in views])
    furthest = np.linalg.norm((positions - normalisation.centre) * normalisation.scale, axis=-1).max()
    near = np.linalg.norm(scene, axis=-1) < furthest
    return views_of(views, normalisation, scene) >= np.where(near, min(needed, len(views)), 1)


def views_of(views: tuple[View, ...], normalisation: Normalisation, scene: NDArray[np.float64]) -> NDArray[np.int_]:
    """(n,) How many views have each of the (n, 3) scene points in their picture, or nearly so."""
    world = scene / normalisation.scale + normalisation.centre
    count = np.zeros(len(world), int)
    for view in views:
        points = (world - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        camera = view.camera.undistorted()  # a margin of a tenth of the picture covers the lens
        front = points[:, 2] > 1e-9
        column, row = camera.project(np.where(front[:, None], points, [0, 0, 1.0])).T
        margin = 0.1 * max(camera.width, camera.height)
        count += (
            front
            & (np.abs(column - camera.width / 2) < camera.width / 2 + margin)
            & (np.abs(row - camera.height / 2) < camera.height / 2 + margin)
        )
    return count
