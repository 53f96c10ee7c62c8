"""What surfaces of the simulated laboratory are made of. Colours are linear light; nothing here knows of a renderer."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Matt:
    """A surface that scatters light evenly: one colour (3,), or a texture (h, w, 3), in linear light."""

    reflectance: NDArray[np.float32]


@dataclass(frozen=True)
class Metal:
    """A rough metal."""

    name: str
    """As the renderer's table of measured metals has it: Au, Ag, Al, Cu, Cr (for steel)."""
    roughness: float
    """Microfacet alpha: 0.03 a mirror, 0.05 polished, 0.3 brushed."""


@dataclass(frozen=True)
class Plastic:
    """A coloured body (3,) under a clear, rough surface: boards, housings."""

    colour: tuple[float, float, float]
    roughness: float


@dataclass(frozen=True)
class Glass:
    """Clear and smooth; light passes through and bends."""

    refraction: float
    """Index: 1.52 crown glass, 1.544 quartz."""


Material = Matt | Metal | Plastic | Glass
