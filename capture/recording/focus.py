"""A measure of sharpness that hardly depends on what a picture shows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging.images import linear_from_srgb

COARSE_PX = 1.5  # standard deviation of the blur that removes the fine structure [px]


def luminance(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """(height, width) linear brightness, 0 to 1, of an 8- or 16-bit sRGB picture (height, width, 3)."""
    return linear_from_srgb(pixels.astype(np.float32) / np.iinfo(pixels.dtype).max).mean(axis=-1)


def sharpness(pixels: NDArray[Any]) -> float:
    """Ratio of the slopes of a picture and of its blurred copy, in the direction where the ratio is smallest.

    Fine structure gives a large value; a blur in any direction brings it towards 1. A slope is the root mean square
    difference of neighbours along rows, columns or a diagonal. Sensor noise is subtracted from the slope of the picture; it
    is estimated from the median absolute diagonal second difference (after Immerkaer 1996), which edges hardly change.
    """
    from scipy.ndimage import gaussian_filter

    light = np.sqrt(luminance(pixels))  # makes shot noise nearly uniform
    fine = np.maximum(_slopes(light) - 2 * _noise_variance(light), 1e-9)
    return float(np.sqrt(fine / np.maximum(_slopes(np.asarray(gaussian_filter(light, COARSE_PX), np.float32)), 1e-9)).min())


def _slopes(light: NDArray[np.float32]) -> NDArray[np.floating]:
    """(4,) mean squared difference of neighbours: along rows, columns, and both diagonals."""
    pairs = (
        (light[:, 1:], light[:, :-1]),
        (light[1:], light[:-1]),
        (light[1:, 1:], light[:-1, :-1]),
        (light[1:, :-1], light[:-1, 1:]),
    )
    return np.array([np.mean((one - other) ** 2) for one, other in pairs])


def _noise_variance(light: NDArray[np.float32]) -> float:
    mask = light[:-2, :-2] + light[:-2, 2:] + light[2:, :-2] + light[2:, 2:] + 4 * light[1:-1, 1:-1]
    mask = mask - 2 * (light[:-2, 1:-1] + light[2:, 1:-1] + light[1:-1, :-2] + light[1:-1, 2:])
    return float((np.median(np.abs(mask)) / (0.6745 * 6.0)) ** 2)
