"""Small files that ask for much: headers, streams of zeros, aliases, archives."""

import pickle
import struct
import zipfile
import zlib
from functools import lru_cache
from os import mkdir
from pathlib import Path
from typing import Any

import numpy as np


class Trap:
    """Leaves a folder behind where it is unpickled."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return (mkdir, (self.path,))


def pickled(path: Path, trap: Path, way: int) -> None:
    """Replace an array file by one that runs code where it is unpickled."""
    array = np.array([Trap(str(trap))], dtype=object)
    if way == 0:
        path.write_bytes(pickle.dumps(Trap(str(trap))))
    elif path.suffix == ".npy":
        np.save(path, array, allow_pickle=True)
    else:
        with np.load(path) as stored:
            names = list(stored.files)
        np.savez(path, **{name: array for name in names})  # type: ignore[arg-type]


def zip_bomb(path: Path) -> None:
    """Replace an archive by one whose first arrays unpack to 150 MB each."""
    with np.load(path) as stored:
        names = list(stored.files)
    header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000,), }".ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names[:2]:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                file.write(header)
                for _ in range(150):
                    file.write(b"\0" * 2**20)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(side: int) -> bytes:
    """A PNG whose header promises side x side pixels, and holds next to none."""
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + _chunk(b"IEND", b"")


@lru_cache
def png_of_zeros(side: int) -> bytes:
    """A sound PNG of side x side black RGB pixels: a thousandth of its size in memory."""
    packer, packed = zlib.compressobj(9), []
    row = b"\0" * (1 + 3 * side)
    for _ in range(side):
        packed.append(packer.compress(row))
    packed.append(packer.flush())
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", b"".join(packed)) + _chunk(b"IEND", b"")


def jpeg_header(side: int) -> bytes:
    """A JPEG whose header promises side x side pixels."""
    size = struct.pack(">HH", min(side, 65500), min(side, 65500))
    frame = b"\xff\xc0\x00\x11\x08" + size + b"\x03\x01\x11\x00\x02\x11\x00\x03\x11\x00"
    return b"\xff\xd8\xff\xdb\x00\x43\x00" + b"\x01" * 64 + frame + b"\xff\xda" + b"\0" * 200


def tiff_header(side: int) -> bytes:
    """A TIFF whose header promises side x side pixels."""
    entries = [
        (256, 4, 1, side),
        (257, 4, 1, side),
        (258, 3, 1, 8),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (273, 4, 1, 200),
        (277, 3, 1, 1),
        (278, 4, 1, side),
        (279, 4, 1, 1000),
    ]
    body = struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries) + struct.pack("<I", 0)
    return (b"II*\0" + struct.pack("<I", 8) + body).ljust(1300, b"\0")


def aliases(levels: int, width: int, key: str) -> str:
    """YAML of a few hundred bytes in which `key` stands for width ** levels numbers."""
    lines = ["a0: &a0 [" + ", ".join(["0"] * width) + "]"]
    lines += [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}"] * width) + "]" for n in range(1, levels)]
    return "\n".join([*lines, f"{key}: *a{levels - 1}"]) + "\n"


def entities(levels: int) -> str:
    """Declarations of XML in which `a` stands for 10 ** levels letters."""
    lines = [f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, levels)]
    return "".join(['<!ENTITY e0 "aaaaaaaaaa">', *lines, f'<!ENTITY a "&e{levels - 1};">'])
