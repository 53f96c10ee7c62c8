"""Photographs with EXIF headers, written by Pillow or by OpenCV, and what a viewer shows of them, by Pillow."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps
from PIL.TiffImagePlugin import IFDRational

ORIENTATIONS = tuple(range(1, 9))
"""The values of EXIF's tag; 1 is upright, 5 to 8 exchange width and height."""
_TURNS = Image.Transpose
STORED = {
    2: _TURNS.FLIP_LEFT_RIGHT, 3: _TURNS.ROTATE_180, 4: _TURNS.FLIP_TOP_BOTTOM, 5: _TURNS.TRANSPOSE,
    6: _TURNS.ROTATE_90, 7: _TURNS.TRANSVERSE, 8: _TURNS.ROTATE_270,
}  # fmt: skip
"""How an upright picture is turned before it is stored with an orientation; Pillow turns counterclockwise."""
QUALITY = 95
Header = str | int | float


def corners(width: int = 120, height: int = 80) -> NDArray[np.uint8]:
    """A smooth picture with another colour in each corner: none of its eight orientations looks like another."""
    colours = np.array([[[230, 20, 20], [20, 200, 20]], [[20, 20, 230], [240, 240, 240]]], float)
    down, right = np.linspace(0, 1, height)[:, None, None], np.linspace(0, 1, width)[None, :, None]
    upper, lower = ((1 - right) * row[0] + right * row[1] for row in colours)
    return np.rint((1 - down) * upper + down * lower).astype(np.uint8)


def write(path: Path, picture: NDArray[np.uint8], *, orientation: int = 1, **header: Header) -> None:
    """A file by Pillow, of the format of its suffix, of which a viewer shows `picture`; `header` has EXIF's names."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _stored(picture, orientation).save(path, exif=exif(orientation, **header), quality=QUALITY)


def write_with_opencv(path: Path, picture: NDArray[np.uint8], *, orientation: int = 1, **header: Header) -> None:
    """The same by OpenCV as a JPEG in an existing folder; OpenCV takes the header's bytes from Pillow."""
    pixels = cv2.cvtColor(np.asarray(_stored(picture, orientation)), cv2.COLOR_RGB2BGR)
    stated = np.frombuffer(exif(orientation, **header).tobytes().removeprefix(b"Exif\0\0"), np.uint8)
    quality = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    assert cv2.imwriteWithMetadata(str(path), pixels, [cv2.IMAGE_METADATA_EXIF], [stated], quality)


def exif(orientation: int = 1, **header: Header) -> Image.Exif:
    """A header as cameras write it: fractions for what is not whole, what tells of the exposure in the part for it."""
    made = Image.Exif()
    made[ExifTags.Base.Orientation] = orientation
    for name, value in header.items():
        tag = ExifTags.Base[name]
        part = made.get_ifd(ExifTags.IFD.Exif) if tag > ExifTags.Base.Copyright else made
        part[tag] = IFDRational(Fraction(value).limit_denominator(10_000)) if isinstance(value, float) else value
    return made


def shown(path: Path) -> NDArray[np.uint8]:
    """(height, width, channels) that a viewer shows, by Pillow; of grey pictures (height, width)."""
    with Image.open(path) as picture:
        return np.asarray(ImageOps.exif_transpose(picture))


def header_of(path: Path) -> dict[str, Any]:
    """What Pillow finds in a header, by EXIF's names."""
    with Image.open(path) as picture:
        found = picture.getexif()
        return {ExifTags.TAGS[tag]: value for part in (found, found.get_ifd(ExifTags.IFD.Exif)) for tag, value in part.items()}


def _stored(picture: NDArray[np.uint8], orientation: int) -> Image.Image:
    """What a file with an orientation holds of a picture."""
    upright = Image.fromarray(picture)
    return upright.transpose(STORED[orientation]) if orientation in STORED else upright
