"""EXR files by OpenImageIO, with channels of any names, stored as half floats or floats; and what it says of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray


def write(
    path: Path,
    channels: Mapping[str, NDArray[np.float32]],
    kind: str,
    *,
    window: tuple[int, int] = (0, 0),
    display: tuple[int, int] | None = None,
) -> None:
    """A file with these (height, width) channels, as `kind`, "half" or "float". EXR's colours are multiplied by its alpha.

    Args:
        window: column and row of the picture at which they begin.
        display: width and height of the picture; None for theirs.
    """
    pixels = np.stack([*channels.values()], axis=-1)
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, kind)
    spec.channelnames = tuple(channels)
    spec.x, spec.y = window
    spec.full_width, spec.full_height = display or (width, height)
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(), pixels)
    assert buffer.write(str(path)), buffer.geterror()


def read(path: Path) -> dict[str, NDArray[np.float32]]:
    """The (height, width) channels by name, in OpenImageIO's order: colours, then alpha, then all others."""
    buffer = oiio.ImageBuf(str(path))
    pixels = np.asarray(buffer.get_pixels(oiio.FLOAT))
    return dict(zip(buffer.spec().channelnames, np.moveaxis(pixels, -1, 0), strict=True))
