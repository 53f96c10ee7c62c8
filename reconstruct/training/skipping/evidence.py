"""What decides on skips: footprints, masks and lenses of a scene, found out before anything is trained."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.sampling.occupancy import cell_centres
from koala3d.reconstruct.scene.frustum import Frustum
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, scaled_camera
from koala3d.reconstruct.training.skipping.gains import Differences

PLACES = 2000
"""Places of the object at which footprints are measured."""


@dataclass(frozen=True)
class Evidence:
    """Of one scene, its training views and the space that they leave."""

    bounded: bool
    views: int
    transparent: float
    """Share of the training pixels that belong to nothing (alpha below a hundredth)."""
    smallest: float
    """Smallest footprint of a pixel at any place that can hold something [scene unit]."""
    largest: float
    """Largest one at the object."""
    possible: float
    """Share of the grid's cells that can hold anything: inside the masks, or in sight of enough cameras."""
    bent: int
    """Views through a lens that distorts."""
    frustum: Frustum | None
    """What the cameras see, where they all look the same way."""
    poses: str
    """Where the poses come from."""
    object_known: bool = True
    """Whether masks or the scene's box say what the object is."""
    gains: Differences | None = None
    """Exposure and white balance of the views; None: not measured."""
    matte: float | None = None
    """Share of the object that keeps its colour from view to view; None: not known."""


def evidence_of(
    scene: Scene,
    views: tuple[View, ...],
    pixels: Pixels,
    normalisation: Normalisation,
    possible: NDArray[np.bool_] | None,
    scale: float,
    gains: Differences | None = None,
    matte: float | None = None,
) -> Evidence:
    """Look at a scene.

    Args:
        possible: cells that masks or sight leave, as the occupancy grid takes them; None: nothing is ruled out.
        scale: share of their size that the images are resampled to.
    """
    bounded = normalisation.bounded
    smallest, largest = footprints(views, normalisation, places(normalisation, possible), scale)
    if not bounded:  # surroundings may come as near as anything does
        smallest = min([smallest, *(pixel_width(view, scale) * normalisation.near for view in views)])
    share = 1.0 if possible is None else float(possible.mean())
    if not normalisation.space.single_grid and possible is not None:
        outside = np.linalg.norm(cell_centres(round(len(possible) ** (1 / 3)), 2.0), axis=-1)
        share = float(possible[(outside > 1) & (outside < 2)].mean())
    return Evidence(
        bounded=bounded,
        frustum=normalisation.frustum,
        views=len(views),
        transparent=float(np.mean(np.asarray(pixels.colour[:, 3]) < 0.01)),
        smallest=smallest,
        largest=largest,
        possible=share,
        bent=sum(not view.camera.is_pinhole for view in views),
        poses=str(scene.provenance.get("format", "the scene's files")),
        object_known=bounded or scene.box_is_stated,
        gains=gains,
        matte=matte,
    )


def places(normalisation: Normalisation, possible: NDArray[np.bool_] | None) -> NDArray[np.float64]:
    """(n, 3) places of the object [scene unit]: of the cells that masks leave, else of its cube or ball."""
    if normalisation.bounded and possible is not None and possible.any():
        centres = cell_centres(round(len(possible) ** (1 / 3)), 1.0)[possible]
    else:
        centres = cell_centres(12, 1.0)
        centres = centres if normalisation.bounded else centres[np.linalg.norm(centres, axis=-1) < 1]
    return centres[:: max(1, len(centres) // PLACES)]


def pixel_width(view: View, scale: float) -> float:
    """Width of a view's pixels at unit depth."""
    camera = scaled_camera(view, scale)
    return float(1 / np.sqrt(camera.fx * camera.fy))


def footprints(
    views: tuple[View, ...], normalisation: Normalisation, points: NDArray[np.float64], scale: float
) -> tuple[float, float]:
    """Smallest and largest footprint of a pixel [scene unit] over all views and those of the points that they show."""
    found = [np.zeros(0)]
    world = points / normalisation.scale + normalisation.centre
    for view in views:
        camera = scaled_camera(view, scale).undistorted()
        local = (world - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        local = local[local[:, 2] * normalisation.scale > max(normalisation.near, 1e-6)]
        pixel = camera.project(local)
        shown = np.all((pixel >= 0) & (pixel <= [camera.width, camera.height]), -1)
        found.append(local[shown, 2] * normalisation.scale * pixel_width(view, scale))
    widths = np.concatenate(found)
    return (float(widths.min()), float(widths.max())) if len(widths) else (0.0, np.inf)
