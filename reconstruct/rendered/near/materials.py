"""Materials of the near scenes, independent of the renderer. Colours are linear; places in the unit of the scene."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pattern = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Values (n, channels) at places (n, 3)."""


@dataclass(frozen=True)
class Metal:
    """A rough metal: all its light is specular."""

    name: str
    """In the renderer's table of measured metals: Au, Ag, Al, Cu, Cr."""
    roughness: float
    """Microfacet alpha: 0.03 is a mirror, 0.3 is brushed."""
    across: float | None = None
    """The same across the direction of brushing, which goes around the x axis; None: rough alike in all directions."""


@dataclass(frozen=True)
class Matte:
    """Scatters evenly: all its light is diffuse."""

    colour: Pattern


@dataclass(frozen=True)
class Coated:
    """Two colours below a clear coat: both kinds of light. Must be convex and alone, so that its parts add up."""

    first: tuple[float, float, float]
    second: tuple[float, float, float]
    share: Pattern
    """Of the second colour."""
    roughness: float


@dataclass(frozen=True)
class Partly:
    """A metal where `share` is one and matte where it is zero. Must be convex and alone, so that its parts add up."""

    colour: Pattern
    metal: Metal
    share: Pattern


@dataclass(frozen=True)
class Glass:
    """Clear and smooth: all its light is specular."""

    refraction: float


Material = Metal | Matte | Coated | Partly | Glass


def plain(*colour: float) -> Pattern:
    """The same everywhere."""
    return lambda places: np.broadcast_to(np.asarray(colour), (len(places), len(colour)))


def chequers(frequency: float, sharpness: float = 12.0) -> Pattern:
    """One and zero in turn in cells of a cubic lattice with soft edges."""
    return lambda p: 1 / (1 + np.exp(-sharpness * np.prod(np.sin(frequency * p + 0.4), -1, keepdims=True)))


def patches(first: tuple[float, ...], second: tuple[float, ...], frequency: float) -> Pattern:
    """Two colours in turn in such cells."""
    share = chequers(frequency)
    return lambda p: np.asarray(first) + share(p) * (np.asarray(second) - np.asarray(first))


def veins(first: tuple[float, ...], second: tuple[float, ...], frequency: float) -> Pattern:
    """Marble: bands that are bent by waves of three lengths."""

    def colour(p: NDArray[np.float64]) -> NDArray[np.float64]:
        bent = sum(np.sin(frequency * scale * p[:, [1, 2, 0]] + scale) / scale for scale in (1.0, 2.1, 4.3))
        share = 0.5 + 0.5 * np.sin(frequency * p.sum(-1) + 1.5 * bent.sum(-1))
        return np.asarray(first) + share[:, None] ** 2 * (np.asarray(second) - np.asarray(first))

    return colour


def above(height: float, width: float) -> Pattern:
    """One above a wavy line around the z axis, zero below it, within `width`."""

    def share(p: NDArray[np.float64]) -> NDArray[np.float64]:
        line = height + 0.12 * np.sin(3 * np.arctan2(p[:, 1], p[:, 0]))
        return np.clip((p[:, 2:] - line[:, None]) / width + 0.5, 0, 1)

    return share
