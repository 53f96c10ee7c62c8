"""What the file of a mask marks as the object's: a channel of many, labels, and the noise of compression."""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

LABELS = 0.1
"""Largest value of a mask that holds labels (1, 2, ... of 255) instead of white."""
COMPRESSION_NOISE = 0.15
"""How far lossy compression takes black and white apart from 0 and 1 near an edge."""


def marked(stored: NDArray[Any]) -> NDArray[Any]:
    """(rows, columns, 1) of a mask as `images.read_stored` has it: its alpha if that is not opaque everywhere, else its brightest
    colour. Labels become white."""
    white = 1 if stored.dtype == np.float32 else int(np.iinfo(stored.dtype).max)
    colours = np.moveaxis(stored[..., : 3 if stored.shape[-1] > 2 else 1], -1, 0)
    has_alpha = stored.shape[-1] in (2, 4) and stored[..., -1].min() < white
    mask = np.ascontiguousarray(stored[..., -1] if has_alpha else functools.reduce(np.maximum, colours))[..., None]
    return np.where(mask > 0, mask.dtype.type(white), 0) if 0 < mask.max() <= LABELS * white else mask


def without_noise(mask: NDArray[np.float32]) -> NDArray[np.float32]:
    """A mask in 0..1 from a file of lossy compression, as it may have been before."""
    return np.clip((mask - COMPRESSION_NOISE) / (1 - 2 * COMPRESSION_NOISE), 0, 1)
