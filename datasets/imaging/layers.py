"""What a file's channels are: colours and alpha are found by name, an associated alpha becomes straight, a part the whole.

The colours of an EXR are multiplied by its alpha, and those of some TIFFs. An EXR may hold further channels (depth, masks of
renderers), and only the part of the picture that shows anything.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

COLOURS = (("R", "G", "B"), ("Y",))
"""Names of colour channels."""


def chosen(spec: Any) -> list[int]:
    """Indices of the channels that are read: an EXR's colours and alpha; all if none has the name of a colour."""
    names = list(spec.channelnames)
    for colours in COLOURS if _is_exr(spec) else ():
        if all(name in names for name in colours):
            return [names.index(name) for name in (*colours, "A") if name in names]
    return list(range(spec.nchannels))


def size(spec: Any) -> tuple[int, int]:
    """(width, height) of the whole picture; the file may hold a part of it."""
    return (spec.full_width, spec.full_height) if _is_part(spec) else (spec.width, spec.height)


def whole(pixels: NDArray[Any], spec: Any) -> NDArray[Any]:
    """(height, width, channels) of the whole picture, zero where the file holds nothing."""
    if not _is_part(spec):
        return pixels
    width, height = size(spec)
    result = np.zeros((height, width, pixels.shape[-1]), pixels.dtype)
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    rows = slice(max(top, 0), min(top + spec.height, height))
    columns = slice(max(left, 0), min(left + spec.width, width))
    if rows.start < rows.stop and columns.start < columns.stop:
        result[rows, columns] = pixels[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    return result


def has_associated_alpha(spec: Any) -> bool:
    """Whether the file's colours are multiplied by its alpha."""
    return spec.alpha_channel >= 0 and not spec.getattribute("oiio:UnassociatedAlpha")


def straight(pixels: NDArray[Any]) -> NDArray[Any]:
    """Colours divided by the alpha, the last channel, that they were multiplied by; unchanged where it is zero."""
    alpha = pixels[..., -1:].astype(np.float32)
    if pixels.dtype == np.float32:
        return np.concatenate([pixels[..., :-1] / np.where(alpha > 0, alpha, 1), pixels[..., -1:]], axis=-1, dtype=np.float32)
    top = np.iinfo(pixels.dtype).max
    colours = np.minimum(pixels[..., :-1] * (top / np.where(alpha > 0, alpha, top)) + 0.5, top)
    return np.concatenate([colours.astype(pixels.dtype), pixels[..., -1:]], axis=-1)


def _is_part(spec: Any) -> bool:
    """Whether an EXR file's data window differs from its display window."""
    held, shown = (spec.x, spec.y, spec.width, spec.height), (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
    return held != shown and _is_exr(spec)


def _is_exr(spec: Any) -> bool:
    return spec.getattribute("openexr:lineOrder") is not None
