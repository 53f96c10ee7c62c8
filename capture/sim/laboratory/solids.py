"""Signed distances of simple solids, and smooth unions and differences.

A distance function takes (..., 3) points [m] and returns (...) distances [m], negative inside. `smooth` is the length over
which two surfaces blend [m].
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Field = NDArray[np.floating]
Distance = Callable[[Field], Field]


def ellipsoid(points: Field, centre: ArrayLike, radii: ArrayLike) -> Field:
    """Approximate distance from an axis-aligned ellipsoid: exact at the surface, of first order elsewhere."""
    local = points - np.asarray(centre, np.float32)
    radii = np.asarray(radii, np.float32)
    scaled = np.linalg.norm(local / radii, axis=-1)
    slope = np.linalg.norm(local / radii**2, axis=-1)
    return scaled * (scaled - 1) / np.maximum(slope, 1e-6)


def sphere(points: Field, centre: ArrayLike, radius: float) -> Field:
    """Distance from a sphere."""
    return np.linalg.norm(points - np.asarray(centre, np.float32), axis=-1) - np.float32(radius)


def rod(points: Field, start: ArrayLike, end: ArrayLike, start_radius: float, end_radius: float) -> Field:
    """Approximate distance from a rounded rod whose radius changes linearly from `start` to `end`."""
    start, axis = np.asarray(start, np.float32), np.subtract(end, start).astype(np.float32)
    local = points - start
    share = np.clip(local @ axis / (axis @ axis), 0, 1)
    nearest = local - share[..., None] * axis
    return np.linalg.norm(nearest, axis=-1) - (start_radius + (end_radius - start_radius) * share)


def drum(points: Field, centre: ArrayLike, radius: float, half_height: float, rounding: float) -> Field:
    """Distance from an upright cylinder with rounded edges."""
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
    """`solid` minus `tool`, the edge rounded over about `smooth`."""
    return -joined(-solid, tool, smooth)
