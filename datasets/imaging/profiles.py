"""Colours of a picture that states other ones than sRGB's: phones write Display P3, cameras Adobe RGB.

An ICC profile of three primaries and three curves is followed (ICC.1:2022, annex F): curves give light, a matrix XYZ, and from
there it goes to sRGB. Profiles of tables, as printers and scanners have them, are refused.
"""

import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging.srgb import srgb_from_linear

PRIMARIES = np.array([[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]])
"""(3, 3) XYZ of sRGB's red, green and blue in its columns, adapted to D50 (Lindbloom)."""
STEPS = 4096
"""Values at which a curve is tabulated."""
SAME = 1.5 / 255
"""Largest change of a colour that rounding in profiles explains: such a profile is sRGB's."""
MOST_TAGS = 256


class Unreadable(ValueError):
    """A profile that is damaged or made of tables."""


@dataclass(frozen=True, eq=False)
class Conversion:
    """From a profile's colours to sRGB."""

    curves: NDArray[np.float32]
    """(3, `STEPS`) light of values from 0 to 1."""
    matrix: NDArray[np.float32]
    """(3, 3) to the light of sRGB's primaries."""

    def __call__(self, picture: NDArray[Any]) -> NDArray[Any]:
        """(height, width, 3 or 4) picture of the same type in sRGB; an alpha is kept."""
        import cv2

        top = 1.0 if picture.dtype == np.float32 else float(np.iinfo(picture.dtype).max)
        values = picture[..., :3].astype(np.float32) * np.float32((STEPS - 1) / top)
        light = np.stack([self._light(values[..., k], k) for k in range(3)], axis=-1)
        light = np.asarray(cv2.transform(light, self.matrix)).reshape(light.shape)
        encoded = srgb_from_linear(np.clip(light, 0, 1)) * np.float32(top)
        result = picture.copy()
        result[..., :3] = encoded if picture.dtype == np.float32 else encoded + 0.5
        return result

    def _light(self, values: NDArray[np.float32], channel: int) -> NDArray[np.float32]:
        below = np.clip(values, 0, STEPS - 1).astype(np.int32)
        curve = self.curves[channel]
        first, second = curve[below], curve[np.minimum(below + 1, STEPS - 1)]
        return first + (second - first) * (values - below)


@lru_cache(maxsize=8)
def conversion(profile: bytes) -> Conversion | None:
    """What takes a profile's colours to sRGB; None if they are sRGB's, or no RGB.

    Raises:
        Unreadable: the profile is damaged or made of tables.
    """
    if len(profile) < 132 or profile[16:20] != b"RGB ":
        return None
    try:
        primaries, curves = _shape(_tags(profile))
    except Unreadable:
        raise
    except (KeyError, struct.error, IndexError, ZeroDivisionError, ValueError) as error:
        raise Unreadable(f"it has no primaries and curves ({error})") from None
    if not (np.isfinite(curves).all() and np.isfinite(primaries).all()):
        raise Unreadable("its primaries or curves are not finite")
    found = Conversion(curves.astype(np.float32), (np.linalg.inv(PRIMARIES) @ primaries).astype(np.float32))
    grid = np.stack(np.meshgrid(*3 * [np.linspace(0, 1, 6, dtype=np.float32)], indexing="ij"), axis=-1).reshape(36, 6, 3)
    return None if np.abs(found(grid) - grid).max() < SAME else found


def _shape(tags: dict[bytes, bytes]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, 3) XYZ of the primaries in the columns, and (3, `STEPS`) curves."""
    primaries = np.stack([_xyz(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ")], axis=-1)
    with np.errstate(all="ignore"):  # what is not finite is refused
        return primaries, np.stack([_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC")])


def _tags(profile: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", profile, 128)
    found = {}
    for index in range(min(count, MOST_TAGS)):
        if len(profile) < 144 + 12 * index:
            break
        name, start, length = struct.unpack_from(">4sII", profile, 132 + 12 * index)
        found[name] = profile[start : start + length]
    return found


def _xyz(tag: bytes) -> NDArray[np.float64]:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _curve(tag: bytes) -> NDArray[np.float64]:
    """(`STEPS`,) light: a power, a table, or one of the five functions of ICC's parametric curves."""
    x = np.linspace(0, 1, STEPS)
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count <= 1:
            return x ** (struct.unpack_from(">H", tag, 12)[0] / 256) if count else x
        table = np.frombuffer(tag, ">u2", count, 12) / 65535
        return np.interp(x, np.linspace(0, 1, count), table)
    kind = struct.unpack_from(">H", tag, 8)[0] if tag[:4] == b"para" else 5
    if kind > 4:
        raise Unreadable(f"its curves are of kind {tag[:4].decode('latin-1')!r}")
    g, a, b, c, d, e, f = _parameters(kind, np.array(struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12)) / 65536)
    return np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f)


def _parameters(kind: int, given: NDArray[np.float64]) -> tuple[float, ...]:
    """g a b c d e f of (a x + b)^g + e from d on, and c x + f below."""
    g, a, b, c, d, e, f = (*given, *np.zeros(7 - len(given)))
    if kind == 0:
        return g, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if kind in (1, 2):  # zero, or c, below -b / a
        return g, a, b, 0.0, -b / a, c, c
    return g, a, b, c, d, e, f
