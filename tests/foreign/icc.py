"""ICC profiles as phones and cameras embed them, written by hand; Pillow's littleCMS says what their colours are."""

import io
import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

DISPLAY_P3 = ((0.51512, 0.29198, 0.15710), (0.24120, 0.69225, 0.06657), (-0.00105, 0.04189, 0.78407))
ADOBE_RGB = ((0.60974, 0.20528, 0.14919), (0.31111, 0.62567, 0.06322), (0.01947, 0.06087, 0.74457))
SRGB = ((0.43607, 0.38515, 0.14307), (0.22249, 0.71687, 0.06061), (0.01392, 0.09708, 0.71410))
"""XYZ of the primaries in the columns, adapted to D50, as the profiles of Apple, Adobe and HP state them."""
SRGB_CURVE = struct.pack(
    ">4sIHH5i", b"para", 0, 3, 0, *(round(65536 * v) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))
)
ADOBE_CURVE = struct.pack(">4sIIH", b"curv", 0, 1, 563)
"""The power 2.19921875."""


def table_curve(power: float, count: int = 256) -> bytes:
    values = np.rint(65535 * np.linspace(0, 1, count) ** power).astype(">u2")
    return struct.pack(">4sII", b"curv", 0, count) + values.tobytes()


def profile(primaries: Sequence[Sequence[float]], curve: bytes) -> bytes:
    """A display profile of version 2 with these primaries and one curve for all."""
    xyz = [struct.pack(">4sI3i", b"XYZ ", 0, *(round(65536 * row[k]) for row in primaries)) for k in range(3)]
    white = struct.pack(">4sI3i", b"XYZ ", 0, *(round(65536 * v) for v in (0.9642, 1.0, 0.8249)))
    text = struct.pack(">4sII", b"desc", 0, 5) + b"test\0" + bytes(78 + 8)
    content = dict(zip((b"rXYZ", b"gXYZ", b"bXYZ"), xyz, strict=True)) | {
        b"wtpt": white,
        b"desc": text,
        b"cprt": b"text\0\0\0\0none\0",
    }
    content |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
    table, body, start = b"", b"", 132 + 12 * len(content)
    for name, data in content.items():
        data += bytes(-len(data) % 4)
        table += struct.pack(">4sII", name, start + len(body), len(data))
        body += data
    head = struct.pack(">I4sI4s4s4s", start + len(body), b"\0\0\0\0", 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    head += struct.pack(
        ">6H4sIIIIQI3i", 2026, 1, 1, 0, 0, 0, b"acsp", 0, 0, 0, 0, 0, 0, *(round(65536 * v) for v in (0.9642, 1.0, 0.8249))
    )
    return head.ljust(128, b"\0") + struct.pack(">I", len(content)) + table + body


def in_srgb(picture: NDArray[np.uint8], icc: bytes) -> NDArray[np.uint8]:
    """What littleCMS makes of a picture in a profile's colours."""
    made = ImageCms.buildTransform(ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB"), "RGB", "RGB", 1)
    found = ImageCms.applyTransform(Image.fromarray(picture), made)
    assert found is not None
    return np.asarray(found)
