"""Drawing on the live picture: focus peaking, a zebra over clipped pixels, and the frame of the region."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.recording.focus import luminance
from koala3d.capture.sessions.live.analysis import Part
from koala3d.datasets.page.panel import bytes_of
from koala3d.datasets.radiometry.merge import SATURATED

PEAK, FRAME = (255, 40, 200), (60, 220, 120)  # colours of sharp edges and of the region's frame, sRGB
SHARPEST = 0.03
"""Share of the region's pixels that peaking marks at most: those with the steepest slopes."""
STEEP = 0.06
"""Slope of the square root of the light from which an edge counts as sharp [1 / px]."""
STRIPE_PX = 6


def shown(pixels: NDArray[Any], part: Part, *, peaking: bool = True, zebra: bool = True, width: int = 960) -> NDArray[np.uint8]:
    """(h, w, 3) sRGB bytes of a picture for a person, at most `width` wide, with what the marks say drawn on it.

    Args:
        pixels: (height, width, 1 or 3) sRGB, 8 or 16 bits.
        part: the region.
        peaking: mark the sharpest edges in the region.
        zebra: stripe what is clipped.
        width: of the result, at most [px].
    """
    drawn = bytes_of(pixels if pixels.dtype == np.uint8 else pixels / np.float32(65535), pixels.shape[1]).copy()
    if zebra:
        rows, columns = np.indices(pixels.shape[:2])
        stripes = (rows + columns) // STRIPE_PX % 2 == 0
        drawn[clipped(pixels) & stripes] = 0
    if peaking:
        part.of(drawn)[peaks(part.of(pixels))] = PEAK
    for row in (part.top, part.bottom - 1):
        drawn[row, part.left : part.right] = FRAME
    for column in (part.left, part.right - 1):
        drawn[part.top : part.bottom, column] = FRAME
    step = -(-drawn.shape[1] // width)  # whole pixels, so that marks stay as they are
    return np.ascontiguousarray(drawn[::step, ::step])


def clipped(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """(height, width) pixels of an sRGB picture with a clipped channel."""
    from koala3d.datasets.imaging.images import srgb_from_linear

    return (pixels >= float(srgb_from_linear(SATURATED)) * np.iinfo(pixels.dtype).max).any(-1)


def peaks(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """(height, width) pixels of an sRGB picture on its sharpest edges."""
    light = np.sqrt(luminance(pixels))
    down, right = np.gradient(light)
    slope = np.hypot(down, right)
    return (slope > STEEP) & (slope >= float(np.quantile(slope, 1 - SHARPEST)))
