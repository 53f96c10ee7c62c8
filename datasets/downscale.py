"""Pictures made smaller, file by file: area averages of linear light, the file's depth and metadata kept.

One picture is in memory at a time, so that memory does not grow with their number.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets import images
from datasets.camera_model import Camera
from datasets.errors import DatasetError


def camera(full: Camera, factor: int) -> Camera:
    """The camera of a picture at 1/`factor` of its size, rounded to whole pixels."""
    return full.scaled(max(round(full.width / factor), 1), max(round(full.height / factor), 1))


def shrunk(path: Path, width: int, height: int, *, colours: bool = True) -> NDArray[np.generic]:
    """(height, width, channels) of an image file at another size, as deep as the file: uint8, uint16 or float32.

    Args:
        path: file to read. Integers are sRGB, floats linear light; a second or fourth channel is a straight alpha.
        width: new width [px].
        height: new height [px].
        colours: False for masks and depth, whose values are averaged as they are.
    """
    stored = images.read_stored(path)
    if not colours:
        top = 1.0 if stored.dtype == np.float32 else float(np.iinfo(stored.dtype).max)  # type: ignore[type-var]
        small = images.resize(stored.astype(np.float32) / np.float32(top), width, height, srgb=False)
    else:
        small = images.resize_light(images.linear_from_stored(stored), width, height)
        if stored.dtype != np.float32:
            count = small.shape[-1] - (small.shape[-1] in (2, 4))
            small[..., :count] = images.srgb_from_linear(small[..., :count])
    if stored.dtype == np.uint8:
        return images.to_uint8(small)
    return images.to_uint16(small) if stored.dtype == np.uint16 else small


def write(source: Path, target: Path, width: int, height: int, *, colours: bool = True) -> None:
    """Write a picture at another size, its metadata kept. Arguments as of `shrunk`; the suffix of `target` says the format.

    Raises:
        DatasetError: `target` exists, or `source` is missing or damaged.
    """
    if target.exists():
        raise DatasetError("two views would share a file", where=target, remedy="give each view its own name")
    images.write(target, shrunk(source, width, height, colours=colours), metadata=images.metadata(source))
