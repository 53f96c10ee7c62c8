"""Materials of the simulated laboratory, independent of the renderer. Colours are linear."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Matt:
    """A diffuse surface with one linear colour (3,) or a texture (h, w, 3)."""

    reflectance: NDArray[np.float32]


@dataclass(frozen=True)
class Metal:
    """A rough metal."""

    name: str  # name in the renderer's table of measured metals: Au, Ag, Al, Cu, Cr (for steel)
    roughness: float  # microfacet alpha: 0.03 is a mirror, 0.05 polished, 0.3 brushed


@dataclass(frozen=True)
class Plastic:
    """A coloured body under a clear, rough coating: boards, housings."""

    colour: tuple[float, float, float]
    roughness: float


@dataclass(frozen=True)
class Glass:
    """A clear and smooth refracting material."""

    refraction: float  # refractive index: 1.52 for crown glass, 1.544 for quartz


Material = Matt | Metal | Plastic | Glass
