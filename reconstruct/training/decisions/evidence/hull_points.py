"""Where rays of training pixels meet the visual hull of the masks."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from koala3d.datasets.structure.masks.silhouette import PIXELS_APART
from koala3d.reconstruct.scene.rays import Rays

STEPS = 192
"""Steps of a ray through the cube."""

Vectors = Float[np.ndarray, "n 3"]


def pixel_width(rays: Rays) -> float:
    """Width of a pixel at the object [scene unit]."""
    distance = np.linalg.norm(np.asarray(rays.origins, np.float64), axis=-1)
    return float(np.median(np.asarray(rays.radii) * distance) * np.sqrt(12) / 2)


def hull_points(
    origins: Vectors, viewdirs: Vectors, possible: Bool[np.ndarray, " cells"], pixel: float
) -> tuple[Vectors, Vectors]:
    """Where rays meet the hull, smoothed, and its unit outward normals; zero normals for those that miss it.

    Args:
        pixel: width of a pixel at the object [scene unit]. Cells are left that are partly inside the masks, or nearly so:
            the hull is as much smaller.
    """
    size = round(len(possible) ** (1 / 3))
    solid = possible.reshape((size,) * 3)
    wider = np.sqrt(3) / 2 + PIXELS_APART * pixel * size / 2
    depth = distance_transform_edt(solid) - distance_transform_edt(~solid) - wider
    soft = gaussian_filter(depth.astype(np.float32), 1.5)
    nearest, reach = -np.sum(origins * viewdirs, -1), np.sqrt(3)
    t = nearest[:, None] + np.linspace(-reach, reach, STEPS)
    along = origins[:, None] + t[..., None] * viewdirs[:, None]
    cell = np.clip((along + 1) / 2 * size, 0, size - 1).astype(int)
    inside = (soft[tuple(np.moveaxis(cell, -1, 0))] > 0) & np.all(np.abs(along) < 1, -1)
    points = along[np.arange(len(t)), inside.argmax(-1)]
    place = ((points + 1) / 2 * size - 0.5).T
    slope = np.stack([map_coordinates(axis, place, order=1, mode="nearest") for axis in np.gradient(soft)], -1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    return points, np.where(inside.any(-1, keepdims=True), -slope / np.maximum(length, 1e-9), 0.0)
