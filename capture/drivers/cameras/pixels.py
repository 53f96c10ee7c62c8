"""From the pixel formats of a camera to sRGB pictures: the GenICam names of the formats, and demosaicing."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.measurements import Pixels
from koala3d.datasets.imaging.images import srgb_from_linear
from koala3d.datasets.radiometry.mosaic import interpolated, pattern_of

RGB8 = ("RGB8", "RGB8Packed", "RGBa8", "BGR8")
"""Eight-bit colour in USB cameras, in GigE cameras and the emulation, and what other makers send."""
PATTERNS = ("RG", "GB", "BG", "GR")  # colours of the first two pixels of the mosaic's first row
CANDIDATES = {"rgb8": RGB8} | {f"bayer{bits}": tuple(f"Bayer{pattern}{bits}" for pattern in PATTERNS) for bits in (8, 12)}
CANDIDATES |= {"mono8": ("Mono8",), "mono12": ("Mono12",)}
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
    """(height, width, 3 or 1) sRGB picture from the data of a camera in the format `name`.

    Colours in the order red, green, blue are returned without a copy. A raw mosaic (height, width) is linear: it is demosaiced
    with the edge-aware method of OpenCV, then encoded as sRGB. Grey values are linear as well. 8 bits stay 8 bits, 12 become 16.
    """
    pattern = pattern_of(name)
    if not pattern and not name.startswith("Mono"):
        if name.startswith("BGR"):
            return np.ascontiguousarray(raw[..., ::-1])
        return np.ascontiguousarray(raw if raw.shape[-1] == 3 else raw[..., :3])
    linear = interpolated(raw, pattern) if pattern else raw[..., None]
    if name.endswith("12"):
        return _encode(4095, 65535)[np.minimum(linear, 4095)].astype(np.uint16)
    return _encode(255, 255)[linear].astype(np.uint8)


def _encode(linear_white: int, srgb_white: int) -> NDArray[np.float32]:
    """Table from linear levels to sRGB levels."""
    return np.rint(srgb_from_linear(np.arange(linear_white + 1) / linear_white) * srgb_white)
