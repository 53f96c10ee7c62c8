"""Signed distances of simple solids, and how they melt into one another.

A distance function takes (..., 3) points [m] and returns (...,) distances [m], negative inside. The forms are the
well-known ones of constructive solid geometry; `smooth` lengths are those over which two surfaces blend [m].
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Field = NDArray[np.float32]
Distance = Callable[[Field], Field]


def ellipsoid(points: Field, centre: ArrayLike, radii: ArrayLike) -> Field:
    """Nearly the distance to an axis-aligned ellipsoid: exact at the surface, first order beside it."""
    local = points - np.asarray(centre, np.float32)
    radii = np.asarray(radii, np.float32)
    scaled = np.linalg.norm(local / radii, axis=-1)
    slope = np.linalg.norm(local / radii**2, axis=-1)
    return scaled * (scaled - 1) / np.maximum(slope, 1e-6)


def sphere(points: Field, centre: ArrayLike, radius: float) -> Field:
    """Distance to a sphere."""
    return np.linalg.norm(points - np.asarray(centre, np.float32), axis=-1) - np.float32(radius)


def rod(points: Field, start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float) -> Field:
    """Nearly the distance to a rounded rod whose radius changes evenly from `start` to `end`."""
    start, axis = np.asarray(start, np.float32), np.subtract(end, start).astype(np.float32)
    local = points - start
    share = np.clip(local @ axis / (axis @ axis), 0, 1)
    nearest = local - share[..., None] * axis
    return np.linalg.norm(nearest, axis=-1) - (start_radius + (end_radius - start_radius) * share)


def drum(points: Field, centre: ArrayLike, radius: float, half_height: float, rounding: float) -> Field:
    """Distance to an upright cylinder with rounded edges."""
    local = points - np.asarray(centre, np.float32)
    beside = np.hypot(local[..., 0], local[..., 1]) - (radius - rounding)
    above = np.abs(local[..., 2]) - (half_height - rounding)
    outside = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
    return np.minimum(np.maximum(beside, above), 0) + outside - rounding


def joined(first: Field, second: Field, smooth: float) -> Field:
    """Union of two solids with a fillet of about `smooth` (polynomial smooth minimum)."""
    blend = np.maximum(smooth - np.abs(first - second), 0) / smooth
    return np.minimum(first, second) - blend * blend * np.float32(smooth / 4)


def carved(solid: Field, tool: Field, smooth: float) -> Field:
    """`solid` with `tool` taken away, the edge rounded over about `smooth`."""
    return -joined(-solid, tool, smooth)
