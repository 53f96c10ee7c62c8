"""Cells that can hold anything: the masks' visual hull around the object, and what several cameras see around it.

What is ruled out here is never looked at again.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import EXACT, Sight, Silhouette, Slack
from koala3d.datasets.structure.masks.votes import carved
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, scaled_camera

BLOCK = 4
"""Cells per axis of a block."""
NEARER = 1.5
"""How many times nearer to a camera than the middle block the nearest one may be."""
AMONG = 4
"""A camera that is nearer to a block than so many of its radii is among the cells."""


def cells_in_masks(
    pixels: Pixels,
    views: tuple[View, ...],
    normalisation: Normalisation,
    grid: int,
    scale: float,
    *,
    slack: Sequence[Slack] | None = None,
) -> NDArray[np.bool_] | None:
    """(grid^3,) True for cells of the cube that the masks leave to the object; None where all pixels belong to it.

    Masks vote, see `votes`: a cell is left while any part of it is inside enough of the masks.

    Args:
        slack: how far each view's camera may be from where the view has it [scene unit], and turned [rad]; None: not at all.
    """
    alpha = np.asarray(pixels.colour[:, 3])
    if (alpha > 0.99).all():
        return None
    cameras = [scaled_camera(view, scale) for view in views]
    ends = np.cumsum([camera.width * camera.height for camera in cameras])
    masks = np.split(alpha > 0.01, ends[:-1])
    silhouettes = [
        Silhouette(camera, view.world_from_camera, mask.reshape(camera.height, camera.width), (off / normalisation.scale, turned))
        for view, camera, mask, (off, turned) in zip(views, cameras, masks, slack or [EXACT] * len(views), strict=True)
    ]
    order = np.random.default_rng(0).permutation(len(views))  # views far apart rule out most, soonest
    box = np.outer([-1, 1], np.ones(3)) / normalisation.scale + normalisation.centre
    possible = np.zeros(grid**3, bool)
    possible[carved([silhouettes[i] for i in order], box, grid)] = True
    return possible


def pixels_on_cells(
    possible: NDArray[np.bool_], views: tuple[View, ...], normalisation: Normalisation, scale: float
) -> NDArray[np.bool_]:
    """(pixels,) True for those of all views whose rays may meet a possible cell, one view after the other.

    Balls about blocks of cells stand for the cells. A view from among them has all of its pixels.
    """
    cells = round(len(possible) ** (1 / 3))
    whole = np.pad(possible.reshape((cells,) * 3), [(0, -cells % BLOCK)] * 3)
    count, edge = len(whole) // BLOCK, 2 * BLOCK / cells
    occupied = whole.reshape((count, BLOCK) * 3).any((1, 3, 5)).ravel()
    half = edge * count / 2
    points = cell_centres(count, half)[occupied] + (half - 1)
    world, radius = points / normalisation.scale + normalisation.centre, np.sqrt(3) / 2 * edge / normalisation.scale
    found = []
    for view in views:
        camera, position = scaled_camera(view, scale), view.world_from_camera[:3, 3]
        if np.linalg.norm(world - position, axis=-1).min(initial=np.inf) < AMONG * radius:
            found.append(np.ones(camera.width * camera.height, bool))
        else:
            found.append(Sight(camera, view.world_from_camera).covered(world, NEARER * radius)[0].ravel())
    return np.concatenate(found)


def cells_in_sight(views: tuple[View, ...], normalisation: Normalisation, grid: int, needed: int = 3) -> NDArray[np.bool_]:
    """(grid^3,) True for cells of the surroundings that cameras can place.

    In a common frustum these are all that any camera sees. Around an object, a cell nearer than the furthest camera must be in
    the pictures of `needed` cameras: what fewer see cannot be triangulated, and would only be a cloud before a lens. Further
    out, one camera is enough.
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
    among_cameras = np.linalg.norm(scene, axis=-1) < furthest
    return views_of(views, normalisation, scene) >= np.where(among_cameras, min(needed, len(views)), 1)


def views_of(views: tuple[View, ...], normalisation: Normalisation, scene: NDArray[np.float64]) -> NDArray[np.int_]:
    """(n,) How many views have each of the (n, 3) scene points in their picture, or nearly so."""
    world = scene / normalisation.scale + normalisation.centre
    count = np.zeros(len(world), int)
    for view in views:
        camera = view.camera.undistorted()  # a margin of a tenth of the picture covers the lens
        index, _, (column, row) = Sight(camera, view.world_from_camera).projected(world.T, 0.0)
        margin = 0.1 * max(camera.width, camera.height)
        across, down = (np.abs(2 * at - size) < size + 2 * margin for at, size in ((column, camera.width), (row, camera.height)))
        count[index[across & down]] += 1
    return count
