"""Colour mosaics: their patterns, the planes that they consist of, and the interpolation of the missing colours."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FIRST = {"RG": "RGGB", "GB": "GBRG", "BG": "BGGR", "GR": "GRBG"}
"""Colours of a mosaic's first two rows and columns, row by row, by the first two of them."""


def pattern_of(pixel_format: str) -> str:
    """The first two colours of a raw format, such as "RG" of "BayerRG12"; empty for any other format."""
    return pixel_format[5:7] if pixel_format.startswith("Bayer") else ""


def colour_indices(pattern: str) -> NDArray[np.int64]:
    """(2, 2, 1) colour of the first pixels of a mosaic: 0 red, 1 green, 2 blue."""
    return np.array(["RGB".index(letter) for letter in FIRST[pattern]]).reshape(2, 2, 1)


def tiled(planes: NDArray[Any], height: int, width: int) -> NDArray[Any]:
    """(height, width, channels) of a value for each plane, (period, period, channels): period 2 for a mosaic, else 1."""
    period = planes.shape[0]
    if period == 1:
        return planes
    return np.tile(planes, (-(-height // period), -(-width // period), 1))[:height, :width]


def interpolated(raw: NDArray[Any], pattern: str) -> NDArray[Any]:
    """(height, width, 3) colours of a mosaic of integers (height, width), by OpenCV's edge-aware method."""
    import cv2

    # OpenCV names a pattern after the second and third pixel of the second row: the opposite corner of ours
    opposite = {"RG": "BG", "GB": "GR", "BG": "RG", "GR": "GB"}[pattern]
    code = getattr(cv2, f"COLOR_Bayer{opposite}2RGB_EA")
    return np.asarray(cv2.demosaicing(np.ascontiguousarray(raw), code), raw.dtype)


def demosaiced(light: NDArray[np.float32], pattern: str) -> NDArray[np.float32]:
    """(height, width, 3) light of a mosaic of light (height, width), which may exceed 1.

    The interpolation takes 16-bit integers. What is at most 1 is interpolated in steps of 1/65535; near brighter pixels the
    steps are those of the brightest one.
    """
    import cv2

    def at_most(top: float) -> NDArray[np.float32]:
        steps = (np.clip(light, 0, top) * (65535 / top) + 0.5).astype(np.uint16)
        return interpolated(steps, pattern).astype(np.float32) * np.float32(top / 65535)

    picture, brightest = at_most(1.0), float(light.max())
    if brightest <= 1:
        return picture
    near = cv2.dilate((light > 1).astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.where(near[..., None] > 0, at_most(brightest), picture)
