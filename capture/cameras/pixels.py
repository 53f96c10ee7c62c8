"""From what a camera sends to sRGB colours: formats by GenICam's names, and colours out of a Bayer pattern."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from capture.errors import CaptureError
from datasets.imaging.images import srgb_from_linear

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

RGB8 = ("RGB8", "RGB8Packed")
"""Eight-bit colour: what USB cameras call it, and GigE cameras and the emulation."""
PATTERNS = ("RG", "GB", "BG", "GR")
"""Colours of the first two photosites of the first row."""
CANDIDATES = {
    "rgb8": RGB8,
    "bayer8": tuple(f"Bayer{pattern}8" for pattern in PATTERNS),
    "bayer12": tuple(f"Bayer{pattern}12" for pattern in PATTERNS),
}
"""Setting `camera.pixel_format` to GenICam's names; a colour sensor has one pattern and offers no other."""


def choose_format(wanted: str, offered: Collection[str], *, where: str) -> str:
    """GenICam's name for `wanted` that a camera offers.

    Raises:
        CaptureError: it offers none, naming what it does offer.
    """
    found = next((name for name in CANDIDATES[wanted] if name in offered), None)
    if found is None:
        possible = [name for name, names in CANDIDATES.items() if any(one in offered for one in names)]
        raise CaptureError(f"camera does not send {wanted}", where=where, why=f"it offers {', '.join(offered)}",
                           remedy=f"set camera.pixel_format to {' or '.join(possible) or 'none of ours'}")  # fmt: skip
    return found


def colours(raw: Pixels, name: str) -> Pixels:
    """(height, width, 3) sRGB picture of what a camera sent in the format `name`.

    Colour formats are passed on, and not copied. Raw photosites (height, width) are linear: missing colours are interpolated along
    edges (OpenCV's edge-aware method), then brought to sRGB; 8 bits stay 8, 12 bits fill 16.
    """
    if not name.startswith("Bayer"):
        return np.ascontiguousarray(raw)
    import cv2

    # OpenCV names a pattern after the second and third photosite of the second row: the opposite corner of ours
    code = {"RG": cv2.COLOR_BayerBG2RGB_EA, "GB": cv2.COLOR_BayerGR2RGB_EA,
            "BG": cv2.COLOR_BayerRG2RGB_EA, "GR": cv2.COLOR_BayerGB2RGB_EA}[name[5:7]]  # fmt: skip
    linear = cv2.demosaicing(np.ascontiguousarray(raw), code)
    if name.endswith("12"):
        return _encode(4095, 65535)[np.minimum(linear, 4095)].astype(np.uint16)
    return _encode(255, 255)[linear].astype(np.uint8)


def _encode(linear_white: int, srgb_white: int) -> NDArray[np.float32]:
    """Table from linear levels to sRGB levels."""
    return np.rint(srgb_from_linear(np.arange(linear_white + 1) / linear_white) * srgb_white)
