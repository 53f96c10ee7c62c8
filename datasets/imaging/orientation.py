"""Pictures that carry an orientation tag (EXIF 274): upright copies of them, and copies whose tag says that they are upright.

Koala reads pixels as they are stored, since poses and cameras of other programs belong to them. A tag is followed only if
somebody asks for an upright copy, and no picture that Koala writes has a tag other than 1.
"""

import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.pixels import upright

TAG = 274
JPEGS = frozenset({".jpg", ".jpeg"})
BLOCK = 8
"""Side of the blocks of cosines that a JPEG consists of [px]."""


def write_upright(source: Path, target: Path) -> bool:
    """Write the picture as a viewer shows it; False if a JPEG had to be compressed again.

    The blocks of a JPEG are moved and mirrored as they are, if they fill the picture.

    Raises:
        DatasetError: the picture is damaged.
    """
    orientation, is_jpeg = images.orientation(source), source.suffix.lower() in JPEGS
    pixels = images.read_stored(source)
    if is_jpeg and (turned := _turned_blocks(source, orientation)) is not None:
        files.write_bytes(target, turned)
        return True
    images.write(target, upright(pixels, orientation), metadata=images.metadata(source))
    return not is_jpeg


def write_untagged(source: Path, target: Path) -> None:
    """Write the picture's stored pixels, unchanged, without its orientation. Raises DatasetError if it is damaged."""
    if source.suffix.lower() in JPEGS:
        files.write_bytes(target, _untagged(source.read_bytes()))
    else:
        images.write(target, images.read_stored(source), metadata=images.metadata(source))


def _untagged(jpeg: bytes) -> bytes:
    """A JPEG file whose EXIF header says that it is upright."""
    content, at = bytearray(jpeg), 2
    while at + 4 <= len(content) and content[at] == 0xFF and content[at + 1] != 0xDA:
        length = int.from_bytes(content[at + 2 : at + 4], "big")
        if content[at + 1] == 0xE1 and content[at + 4 : at + 10] == b"Exif\0\0":
            _clear(content, at + 10)
        at += 2 + length
    return bytes(content)


def _clear(content: bytearray, start: int) -> None:
    """Set the orientation to 1 in the first directory of the TIFF header at `start`, if it holds one."""
    order = "<" if content[start : start + 2] == b"II" else ">"
    try:
        (directory,) = struct.unpack_from(f"{order}I", content, start + 4)
        (count,) = struct.unpack_from(f"{order}H", content, start + directory)
        for entry in range(start + directory + 2, start + directory + 2 + 12 * count, 12):
            if struct.unpack_from(f"{order}H", content, entry) == (TAG,):
                struct.pack_into(f"{order}H", content, entry + 8, 1)
    except struct.error:  # a header that ends too early holds nothing that others could read
        return


def _turned_blocks(source: Path, orientation: int) -> bytes | None:
    """An upright JPEG file of the same coefficients; None if its blocks do not fill the picture, or the library is absent."""
    try:
        import jpeglib
    except ImportError:  # no wheels for ARM under Linux
        return None
    jpeg = jpeglib.read_dct(str(source))
    sampling = np.array(jpeg.samp_factor)
    high, wide = BLOCK * sampling.max(0)
    if jpeg.has_black or jpeg.height % high or jpeg.width % wide:
        return None
    parts = [_moved(part, orientation) for part in (jpeg.Y, jpeg.Cb, jpeg.Cr) if part is not None]
    tables = jpeg.qt
    if orientation >= 5:
        sampling, tables = sampling[:, ::-1], tables.transpose(0, 2, 1)
    made = jpeglib.from_dct(*parts, qt=np.ascontiguousarray(tables), quant_tbl_no=jpeg.quant_tbl_no)
    made.samp_factor, made.markers = np.ascontiguousarray(sampling), jpeg.markers
    with tempfile.TemporaryDirectory(prefix="koala-jpeg-") as folder:
        path = Path(folder, "upright.jpg")
        made.write_dct(str(path))
        return _untagged(path.read_bytes())


def _moved(blocks: NDArray[Any], orientation: int) -> NDArray[Any]:
    """(rows, columns, 8, 8) coefficients of the upright picture: a mirrored cosine of odd order changes its sign."""
    signs = (-1) ** np.arange(BLOCK)
    if orientation >= 5:
        blocks = blocks.transpose(1, 0, 3, 2)
    if orientation in (3, 4, 7, 8):
        blocks = blocks[::-1] * signs[:, None]
    if orientation in (2, 3, 6, 7):
        blocks = blocks[:, ::-1] * signs
    return np.ascontiguousarray(blocks, np.int16)
