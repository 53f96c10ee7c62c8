"""The curve of sRGB (IEC 61966-2-1)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def linear_from_srgb(srgb: ArrayLike) -> NDArray[np.float32]:
    """Linear light from sRGB values in 0..1 (IEC 61966-2-1)."""
    srgb = np.asarray(srgb, np.float32)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0.0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def srgb_from_linear(linear: ArrayLike) -> NDArray[np.float32]:
    """sRGB values from linear light; the curve continues above 1."""
    linear = np.asarray(linear, np.float32)
    bright = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, linear * 12.92, bright).astype(np.float32)
