"""Directions of the pixels of an equirectangular picture, as assets' light is written.

The picture stands in the asset's frame: its first row is the asset's y axis, its middle column x, and 90 degrees right of that
lies z.
"""

import numpy as np
from jaxtyping import Float

ASSET_FROM_PICTURE = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
"""`equirectangular` has its zenith along z, the asset along y."""


def equirectangular(height: int) -> Float[np.ndarray, "height width 3"]:
    """Unit direction of each pixel's centre: zenith z in the first row, x in the middle column, azimuth falling to the right."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = np.pi - (np.arange(2 * height) + 0.5) / height * np.pi
    across = np.sin(polar)[:, None]
    axes = (across * np.cos(azimuth), across * np.sin(azimuth), np.broadcast_to(np.cos(polar)[:, None], (height, 2 * height)))
    return np.stack(axes, -1)


def directions(base_from_asset: Float[np.ndarray, "4 4"], height: int) -> Float[np.ndarray, "h w 3"]:
    """Unit direction in the world of each pixel of a picture in the asset's frame."""
    return equirectangular(height) @ (base_from_asset[:3, :3] @ ASSET_FROM_PICTURE).T
