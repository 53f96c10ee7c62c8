"""How values of a sensor lie in files: raw values of 12 bits fill the 16 of a PNG, developed ones are sRGB."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images

RAW_BITS = 12
RAW_FOLDER = "raw"
"""Folder of a recording that holds raw pictures; what lies elsewhere is developed."""
LARGEST = 2**64
"""Limit of every number in a frame; clocks and counters have at most 64 bits."""


@dataclass(frozen=True)
class Exposure:
    """One picture of a frame as the sensor read it."""

    file: str
    """Path relative to the recording: below `raw/` raw values, elsewhere developed ones."""
    exposure_us: float
    """Exposure time as read back from the camera [us]."""
    sha256: str
    """Of the file."""

    @classmethod
    def from_json(cls, content: Any) -> Self:
        """Exposure from its dictionary; raises ValueError, KeyError or TypeError where it is not valid."""
        found = cls(content["file"], float(content["exposure_us"]), content["sha256"])
        if not (isinstance(found.file, str) and isinstance(found.sha256, str) and 0 < found.exposure_us < LARGEST):
            raise ValueError(f"exposure is {content!r:.80}")
        return found


@dataclass(frozen=True)
class DepthPicture:
    """Depth that a sensor measured beside a picture."""

    file: str
    """Path relative to the recording."""
    sha256: str
    """Of the file."""

    @classmethod
    def from_json(cls, content: Any) -> Self:
        """From its dictionary; raises ValueError, KeyError or TypeError where it is not valid."""
        found = cls(content["file"], content["sha256"])
        if not (isinstance(found.file, str) and isinstance(found.sha256, str)):
            raise ValueError(f"depth is {content!r:.80}")
        return found


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
