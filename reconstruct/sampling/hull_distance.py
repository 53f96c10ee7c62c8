"""Signed distance to the visual hull of the masks: the shape that a density begins with, see `reconstruct.field.outline`."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from koala3d.reconstruct.field.outline import CELL, GRID
from koala3d.reconstruct.sampling.steps import box_interval
from koala3d.reconstruct.scene.rays import Pixels

SMOOTHED = 2.0
"""Standard deviation by which the distance is smoothed [cells of the masks' grid]."""
RAYS, STEPS = 8_000, 128
"""Rays by which the hull is fitted to the masks, and places on each that are looked at."""
WIDEST = 0.12
"""How far the masks' cells may reach beyond the object [scene unit]."""


def hull_distance(possible: Bool[np.ndarray, " cells"], pixels: Pixels) -> Float[np.ndarray, "x y z"] | None:
    """(GRID, GRID, GRID) distance, negative inside [scene unit]; None where nothing is left.

    A cell is left while any part of it may show the object, so that the cells reach beyond it by one and a pixel. Their border
    is moved in to where it best tells the pixels of the object from the others.

    Args:
        possible: cells of a cubic grid over the object's cube that masks leave.
    """
    if not possible.any():
        return None
    distance = _to_border(possible)
    return distance + _excess(distance, pixels)


def _to_border(possible: Bool[np.ndarray, " cells"]) -> Float[np.ndarray, "x y z"]:
    """The distance to the border of the cells, smoothed."""
    from scipy import ndimage

    cells = round(len(possible) ** (1 / 3))
    inside = np.pad(possible.reshape(cells, cells, cells), cells // 16)  # beyond the cube is outside
    signed = ndimage.distance_transform_edt(~inside) - ndimage.distance_transform_edt(inside)
    smooth = ndimage.gaussian_filter(signed, SMOOTHED) * 2 / cells
    centres = (np.arange(GRID) + 0.5) * (cells / GRID) - 0.5 + cells // 16
    axes = np.meshgrid(centres, centres, centres, indexing="ij")
    return ndimage.map_coordinates(smooth, axes, order=1)


def _excess(distance: Float[np.ndarray, "x y z"], pixels: Pixels) -> float:
    """How far the border lies outside of the masks [scene unit]: rays of the object come that much deeper, others do not."""
    from scipy import ndimage

    chosen = np.random.default_rng(0).permutation(int(pixels.total))[:RAYS]
    rays, colour = pixels.take(jnp.asarray(np.sort(chosen)))
    enter, leave = (np.asarray(t, np.float64) for t in box_interval(rays))
    meet = leave > enter
    t = enter[meet, None] + (leave - enter)[meet, None] * np.linspace(0, 1, STEPS)
    origins, directions = (np.asarray(vectors, np.float64)[meet, None] for vectors in (rays.origins, rays.directions))
    places = (origins + directions * t[..., None] + 1) / CELL - 0.5
    deepest = ndimage.map_coordinates(distance, np.moveaxis(places, -1, 0), order=1, mode="nearest").min(-1)
    order = np.argsort(deepest)
    shown = np.asarray(colour)[meet, 3][order] > 0.5
    if not shown.any():
        return 0.0
    wrong = np.cumsum(~shown) - np.cumsum(shown)  # of all rays, but for a constant, if those up to here were the object's
    return float(np.clip(-deepest[order][np.argmin(wrong)], 0, WIDEST))
