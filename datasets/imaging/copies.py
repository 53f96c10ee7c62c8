"""Copies of large pictures at the size that they are used at, in a folder beside what uses them.

A copy is used as long as size and time of its picture's files stay the same and its own checksum is right. The folder may be
deleted at any time. Where it cannot be written, or the disk has little room, pictures are read from their own files.
"""

import hashlib
import json
import os
import shutil
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files

ROOM = 2**31
"""So much of the disk [bytes] is left free."""
CHECKSUM_BYTES = 4
VERSION = 1
"""Raised when pictures are resampled differently: older copies are then not used."""


@dataclass(frozen=True)
class Copies:
    """The copies in one folder."""

    folder: Path

    def of(
        self, sources: Sequence[Path], width: int, height: int, make: Callable[[], NDArray[Any]], *, how: str = ""
    ) -> NDArray[Any]:
        """The picture of some files at `width` x `height` [px], from its copy if there is one, else from `make`.

        `how` names what else its values depend on.

        Returns:
            The array, read-only and mapped where it comes from the copy.
        """
        if not all(Path(source).is_file() for source in sources):
            return make()  # which knows what to say
        path = self._path(sources, width, height, how)
        found = mapped(path)
        if found is None or found.shape[:2] != (height, width):
            found = make()
            self._keep(path, found)
        return found

    def _path(self, sources: Sequence[Path], width: int, height: int, how: str) -> Path:
        stats = [os.stat(source) for source in sources]
        what = [[os.fspath(Path(source).absolute()) for source in sources], width, height, how]
        state = [[stat.st_size, stat.st_mtime_ns] for stat in stats]
        return self.folder / f"{_digest(what)}-{_digest([state, VERSION])}.npy"

    def _keep(self, path: Path, picture: NDArray[Any]) -> None:
        """Write a copy and remove those of earlier states of its files, if that is possible."""
        try:
            files.make_folder(self.folder)
            if shutil.disk_usage(self.folder).free < picture.nbytes + ROOM:
                return
            with files.atomic_path(path) as temporary, open(temporary, "wb") as file:
                picture = np.ascontiguousarray(picture)
                np.save(file, picture, allow_pickle=False)
                file.write(_checksum(picture))
            for other in self.folder.glob(f"{path.name.split('-')[0]}-*.npy"):
                if other != path:
                    other.unlink(missing_ok=True)
        except OSError:
            return  # a copy saves time, no more


def mapped(path: Path) -> NDArray[Any] | None:
    """The array in a file of `Copies`, read-only and mapped into memory; None where the file is missing or damaged."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if not isinstance(array, np.memmap) or array.dtype.kind not in "uf" or not array.size:
        return None
    end = array.offset + array.nbytes
    if path.stat().st_size != end + CHECKSUM_BYTES:
        return None
    with open(path, "rb") as file:
        file.seek(end)
        return array if file.read() == _checksum(array) else None


def _checksum(array: NDArray[Any]) -> bytes:
    kind = zlib.crc32(f"{array.dtype.str} {array.shape}".encode())
    return zlib.crc32(array.data.cast("B"), kind).to_bytes(CHECKSUM_BYTES, "little")


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]
