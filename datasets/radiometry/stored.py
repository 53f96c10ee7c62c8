"""How values of a sensor lie in files: raw values of 12 bits fill the 16 of a PNG, developed ones are sRGB."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images

RAW_BITS = 12
RAW_FOLDER = "raw"
"""Folder of a recording that holds raw pictures; what lies elsewhere is developed."""


def packed(raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(height, width) raw values of 12 bits in 16: the upper bits are repeated below, so that the largest value is white."""
    return (raw << 4 | raw >> 8).astype(np.uint16)


def is_raw(name: str) -> bool:
    """Whether a file of a recording, named by its relative path, holds raw values."""
    return name.startswith(f"{RAW_FOLDER}/")


def linear(stored: NDArray[Any], *, raw: bool) -> NDArray[np.float32]:
    """(height, width, channels) linear values, 1 is the largest; raw ones are exact multiples of 1/4095."""
    if not raw:
        return images.linear_from_stored(stored)
    return (stored >> 4).astype(np.float32) / np.float32(2**RAW_BITS - 1)


def read(path: Path, *, raw: bool) -> NDArray[np.float32]:
    """`linear` of a file. Raises DatasetError: it is damaged, or raw and not of 16 bits and one channel."""
    stored = images.read_stored(path)
    if raw and (stored.dtype != np.uint16 or stored.shape[-1] != 1):
        raise DatasetError("is not a raw picture", where=path, why=f"{stored.shape[-1]} channels of {stored.dtype}")
    return linear(stored, raw=raw)
