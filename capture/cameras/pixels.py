"""From the pixel formats of a camera to sRGB colours: the GenICam names of the formats, and demosaicing."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from capture.errors import CaptureError
from capture.measurements import Pixels
from datasets.imaging.images import srgb_from_linear

RGB8 = ("RGB8", "RGB8Packed")  # eight-bit colour in USB cameras, and in GigE cameras and the emulation
PATTERNS = ("RG", "GB", "BG", "GR")  # colours of the first two pixels of the mosaic's first row
CANDIDATES = {"rgb8": RGB8} | {f"bayer{bits}": tuple(f"Bayer{pattern}{bits}" for pattern in PATTERNS) for bits in (8, 12)}
"""GenICam names for each value of `camera.pixel_format`. A colour sensor offers only one of the patterns."""


def choose_format(wanted: str, offered: Collection[str], *, where: str) -> str:
    """The GenICam name for `wanted` that a camera offers.

    Raises CaptureError: it offers none; the message lists what it offers.
    """
    found = next((name for name in CANDIDATES[wanted] if name in offered), None)
    if found is None:
        possible = [name for name, names in CANDIDATES.items() if any(one in offered for one in names)]
        remedy = f"set camera.pixel_format to {' or '.join(possible)}" if possible else "use another camera"
        raise CaptureError(f"camera does not send {wanted}", where=where, why=f"it offers {', '.join(offered)}", remedy=remedy)
    return found


def colours(raw: Pixels, name: str) -> Pixels:
    """(height, width, 3) sRGB picture from the data of a camera in the format `name`.

    Colour formats are returned without a copy. A raw mosaic (height, width) is linear: it is demosaiced with the edge-aware
    method of OpenCV, then encoded as sRGB. 8 bits stay 8 bits, 12 bits become 16.
    """
    if not name.startswith("Bayer"):
        return np.ascontiguousarray(raw)
    import cv2

    # OpenCV names a pattern after the second and third pixel of the second row: the opposite corner of ours
    opposite = {"RG": "BG", "GB": "GR", "BG": "RG", "GR": "GB"}[name[5:7]]
    code = getattr(cv2, f"COLOR_Bayer{opposite}2RGB_EA")
    linear = np.asarray(cv2.demosaicing(np.ascontiguousarray(raw), code), raw.dtype)
    if name.endswith("12"):
        return _encode(4095, 65535)[np.minimum(linear, 4095)].astype(np.uint16)
    return _encode(255, 255)[linear].astype(np.uint8)


def _encode(linear_white: int, srgb_white: int) -> NDArray[np.float32]:
    """Table from linear levels to sRGB levels."""
    return np.rint(srgb_from_linear(np.arange(linear_white + 1) / linear_white) * srgb_white)
