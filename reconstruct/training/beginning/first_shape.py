"""The shape and the colour that a training begins with: the masks' visual hull, and what the views of each place on it agree on.

Diffuse light is the same from everywhere, and a reflection adds to it: no view of a place is darker than its diffuse part. A low
quantile of the views' colours is nearly that part on paint, and dark on a mirror, some views of which always show something dark.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from scipy import ndimage

from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks.silhouette import Sight
from koala3d.reconstruct.field.outline import CELL, GRID, Hull
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, scaled_camera

SMOOTHED = 2.0
"""Standard deviation by which the distance is smoothed [cells of the masks' grid]."""
QUANTILE = 0.15
"""Share of the views of a place that may be darker than its diffuse colour: they see another place, since the hull is no surface."""
FEWEST = 5
"""Views of a place that can agree on anything."""
GRAZING = 0.3
"""Cosine between a normal and the direction to a camera below which that view says nothing."""
STEPS = np.arange(2, 48, 2) * CELL
"""Where along a ray the hull may hide a place [scene unit]."""

Points = Float[np.ndarray, "n 3"]


def measured(
    possible: Bool[np.ndarray, " cells"], views: tuple[View, ...], pixels: Pixels, normalisation: Normalisation, scale: float
) -> Hull | None:
    """The hull, or None if masks leave nothing.

    Args:
        possible: cells of the object's cube that masks leave.
        pixels: all those of the views at this scale.
    """
    if not possible.any():
        return None
    distance = signed_distance(possible)
    places, points, normals = surface_of(distance)
    colours = np.full((len(views), len(points), 3), np.nan, np.float32)
    shown_by = np.asarray(pixels.colour)  # without a copy; indexing it there would compile a program for each view
    cameras = [scaled_camera(view, scale) for view in views]
    firsts = np.cumsum([0, *(camera.width * camera.height for camera in cameras)])
    for colour, view, camera, first in zip(colours, views, cameras, firsts, strict=False):
        sight = Sight(camera, view.world_from_camera)
        index, _, (column, row) = sight.projected((points / normalisation.scale + normalisation.centre).T, 0.0)
        shown = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        index, column, row = index[shown], column[shown].astype(int), row[shown].astype(int)
        towards = (view.world_from_camera[:3, 3] - normalisation.centre) * normalisation.scale - points[index]
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        free = np.sum(towards * normals[index], -1) > GRAZING
        free[free] = ~_hidden(distance, points[index[free]], towards[free])
        seen = shown_by[first + row[free] * camera.width + column[free]].astype(np.float32)
        whole = seen[:, 3] > 0.99
        colour[index[free][whole]] = linear_from_srgb(np.clip(seen[whole, :3], 0, 1))
    agreed = np.isfinite(colours[..., 0]).sum(0) >= FEWEST
    common = np.nanquantile(colours[:, agreed], QUANTILE, axis=0) if agreed.any() else np.zeros((0, 3))
    return Hull(distance, _spread(places[agreed], common))


def signed_distance(possible: Bool[np.ndarray, " cells"]) -> Float[np.ndarray, "x y z"]:
    """Signed distance to the border of the cells of a cubic grid [scene unit], smoothed; beyond the cube is outside."""
    cells = round(len(possible) ** (1 / 3))
    around = cells // 16
    inside = np.pad(possible.reshape(cells, cells, cells), around)
    signed = ndimage.distance_transform_edt(~inside) - ndimage.distance_transform_edt(inside)
    smooth = ndimage.gaussian_filter(signed, SMOOTHED) * 2 / cells
    middles = (np.arange(GRID) + 0.5) * (cells / GRID) - 0.5 + around
    return np.asarray(ndimage.map_coordinates(smooth, np.meshgrid(middles, middles, middles, indexing="ij"), order=1))


def surface_of(distance: Float[np.ndarray, "x y z"]) -> tuple[Int[np.ndarray, "n 3"], Points, Points]:
    """The grid's points next to the hull, where the hull is next to them, and its unit outward normals there."""
    near = np.abs(distance) < CELL / 2
    normals = np.stack([slope[near] for slope in np.gradient(distance, CELL)], -1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    places = np.argwhere(near)
    return places, (places + 0.5) * CELL - 1 - distance[near][:, None] * normals, normals


def _hidden(distance: Float[np.ndarray, "x y z"], points: Points, towards: Points) -> NDArray[np.bool_]:
    """Which points on the hull other parts of it hide in these directions."""
    hidden = np.zeros(len(points), bool)
    for step in STEPS:
        cells = np.floor((points + step * towards + 1) / CELL).astype(int)
        within = ((cells >= 0) & (cells < GRID)).all(-1)
        hidden |= within & (distance[tuple(np.clip(cells, 0, GRID - 1).T)] < -CELL / 3)
    return hidden


def _spread(places: Int[np.ndarray, "n 3"], colours: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "x y z 3"]:
    """Colours of some of the grid's points for all of them: that of the nearest, smoothed by a cell; dark if there are none."""
    spread = np.zeros((GRID, GRID, GRID, 3))
    if len(places):
        spread[tuple(places.T)] = colours
        empty = np.ones((GRID,) * 3, bool)
        empty[tuple(places.T)] = False
        nearest = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
        spread = ndimage.gaussian_filter(spread[tuple(nearest)], (1, 1, 1, 0))
    return spread
