"""Safe reading of NumPy files: nothing is unpickled, and no array is larger than its file can justify."""

import io
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError

MAX_BYTES = 2**28  # larger archives, by unpacked size, are refused: ours hold poses and points, not images
_DAMAGE = (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, SyntaxError, TypeError, ValueError)
_BROKEN = (*_DAMAGE, EOFError, tokenize.TokenError, zipfile.BadZipFile, zlib.error)
"""What numpy and zipfile raise for damaged files."""


def read_npy(path: Path) -> NDArray[Any]:
    """The array in a .npy file.

    Raises:
        UsageError: there is no such file, or it is too large.
        DatasetError: it is no array file, holds objects, or is shorter than its header says.
    """
    data = files.read_regular(path, MAX_BYTES, suffixes=(".npy",))
    try:
        return _array(io.BytesIO(data), len(data), where=path)
    except _BROKEN as error:
        raise _refusal(path, error) from None


def read_npz(path: Path, prefixes: tuple[str, ...] = ("",), *, largest: int | None = None) -> dict[str, NDArray[Any]]:
    """The arrays in a .npz file whose names begin with one of `prefixes`. Raises as `read_npy` does.

    Args:
        largest: bytes of the file, and of what it unpacks to; None: `MAX_BYTES`.
    """
    largest = MAX_BYTES if largest is None else largest
    data = files.read_regular(path, largest, suffixes=(".npz",))
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
            entries = [entry for entry in entries if entry.filename.startswith(prefixes)]
            total = sum(entry.file_size for entry in entries)
            if total > largest:
                raise DatasetError("archive unpacks to too much", where=path, why=f"{total} bytes", remedy="write it again")
            found = {}
            for entry in entries:
                data = archive.read(entry)
                name = entry.filename.removesuffix(".npy")
                found[name] = _array(io.BytesIO(data), len(data), where=f"{path}, {name}")
            return found
    except _BROKEN as error:
        raise _refusal(path, error) from None


def numbers(array: NDArray[Any], shape: tuple[int | None, ...], *, where: object) -> NDArray[np.float64]:
    """`array` as float64, if it holds real numbers in the given shape (None: any length); else a DatasetError."""
    fits = array.ndim == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits or array.dtype.kind not in "fiu":
        wanted = " x ".join("n" if length is None else str(length) for length in shape)
        raise DatasetError(f"does not hold {wanted} numbers", where=where, why=f"shape {array.shape}, type {array.dtype}")
    return array.astype(np.float64)


def _array(file: BinaryIO, size: int, *, where: object) -> NDArray[Any]:
    """One array, after its header is checked: plain numbers or text, and no more of them than there are bytes."""
    version = np.lib.format.read_magic(file)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise DatasetError("is a version of .npy that cannot be read", where=where, why=str(version))
    shape, _, kind = readers[version](file)
    if kind.hasobject:
        raise DatasetError("holds Python objects, not plain numbers", where=where, remedy="save it as an array of numbers")
    expected = kind.itemsize
    for length in shape:
        expected *= int(length)
    if not 0 <= expected <= size or min(shape, default=0) < 0:
        raise DatasetError("is cut off", where=where, why=f"its header says {shape} of {kind}, the file has {size} bytes")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def _refusal(path: Path, error: BaseException) -> DatasetError:
    if isinstance(error, DatasetError):
        return error
    why = str(error) or type(error).__name__
    return DatasetError("is not a file of plain arrays", where=path, why=why, remedy="copy it again")
