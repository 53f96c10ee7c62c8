"""SPZ, Niantic's packed splats, version 3 (github.com/nianticlabs/spz): a tenth of a PLY. Written here: no library has wheels.

A gzip stream: a header of 16 bytes, then for all splats one after the other their positions, opacities, colours, scales,
rotations, and spherical harmonics. Coordinates are those of the scene's world, as in all files here. Programs that take SPZ for
right, up, back show the object lying on its side.
"""

import gzip
import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from koala3d.datasets.core import files
from koala3d.reconstruct.splats import harmonics
from koala3d.reconstruct.splats.splats import Splats

MAGIC, VERSION = b"NGSP", 3
COLOUR = 0.15  # what a first coefficient is multiplied by: leaves room for colours beyond 0..1
SMALLEST = 1 / np.sqrt(2)  # bound of all components of a quaternion but the largest


def save(splats: Splats, path: Path) -> None:
    """Write splats as FILE.spz."""
    reach = float(np.abs(splats.points).max())
    bits = int(np.clip(np.floor(np.log2((2**23 - 1) / max(reach, 1e-9))), 0, 24))  # of a position's fraction
    parts = [
        MAGIC + struct.pack("<IIBBBB", VERSION, len(splats.points), harmonics.DEGREE, bits, 0, 0),
        _fixed(splats.points, bits).tobytes(),
        _byte(255 * splats.opacities).tobytes(),
        _byte(255 * (COLOUR * splats.coefficients[:, 0] + 0.5)).tobytes(),
        _byte(16 * (np.log(splats.scales) + 10)).tobytes(),
        _rotations(splats.quaternions).tobytes(),
        _byte(128 * splats.coefficients[:, 1:] + 128).tobytes(),
    ]
    files.write_bytes(path, gzip.compress(b"".join(parts), mtime=0))


def _byte(values: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "..."]:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _fixed(points: Float[np.ndarray, "n 3"], bits: int) -> UInt8[np.ndarray, "n 3 3"]:
    """Little-endian integers of 24 bits."""
    whole = np.round(points * 2.0**bits).astype("<i4")
    return np.ascontiguousarray(whole[..., None]).view(np.uint8).reshape(*whole.shape, 4)[..., :3]


def _rotations(wxyz: Float[np.ndarray, "n 4"]) -> np.ndarray:
    """(n,) 32 bits each: which of x, y, z, w is largest, then sign and nine bits of each of the others."""
    xyzw = np.roll(wxyz, -1, axis=-1)
    largest = np.argmax(np.abs(xyzw), -1)
    rows = np.arange(len(xyzw))
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1, 1)[:, None]
    packed = largest.astype(np.uint32)
    for k in range(4):
        size = np.floor(511 * np.abs(xyzw[:, k]) / SMALLEST + 0.5).astype(np.uint32)
        signed = np.uint32(512) * (xyzw[:, k] < 0) + np.minimum(size, 511)
        packed = np.where(largest == k, packed, packed << np.uint32(10) | signed)
    return packed.astype("<u4")
