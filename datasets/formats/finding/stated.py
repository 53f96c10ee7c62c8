"""Paths that a file of frames states, and the files that they stand for in its folder.

Files move and their paths do not: a path may be absolute, of another machine or of Windows, and lead out of the folder. Nothing
outside is ever opened. Such a path stands for the file in the folder that ends like it, else for the picture of its name in a
folder of images.
"""

import re
from pathlib import Path, PurePosixPath
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.finding.pictures import Listing, homes


def plain(path: str) -> PurePosixPath:
    """A path with "/" between its parts, as programs on Windows do not write it."""
    return PurePosixPath(path.replace("\\", "/").removeprefix("./"))


def leaves(path: PurePosixPath) -> bool:
    """Whether a path is absolute, names a drive, or goes up out of its folder."""
    return path.is_absolute() or re.match(r"[A-Za-z]:", str(path)) is not None or ".." in path.parts


def other_path(frame: dict[str, Any], key: str, folder: Path, *, where: object) -> Path | None:
    """The file that a frame states under a key; None if it states none. Raises DatasetError if it is not in the folder."""
    stated = frame.get(key)
    if not stated:
        return None
    if isinstance(stated, str) and leaves(path := plain(stated)):
        if (found := _ending_like(folder, path, Listing())) is not None:
            return found
        raise DatasetError(f"path {stated!r} leaves the folder", where=where, remedy="use paths relative to it")
    return files.inside(folder, str(plain(stated)) if isinstance(stated, str) else stated, where=where)


class Images:
    """The images that the frames of a file name; suffixes may be missing or differ, and so may the name of their folder.

    Args:
        folder: folder of the file.
        frames: its frames. If all of them name one folder and it does not exist, the first folder of images that holds one of
            their images stands for it.
        home: folder of images that stands for all that are named; None to take the images where the frames say.
    """

    def __init__(self, folder: Path, frames: list[dict[str, Any]], *, where: object, home: str | None = None) -> None:
        self._folder, self._listing = folder, Listing()
        self._home = PurePosixPath(home) if home is not None else None
        self.notes: list[str] = []
        """A line on the folder that stands for the one that the frames name, and on paths that leave the folder."""
        paths = [plain(frame["file_path"]) for frame in frames]
        if home is None:
            self._find_home(paths, where)
        if away := [path for path in paths if leaves(path)]:
            said = f"{len(away)} paths leave the folder, such as {away[0]}"
            self.notes.append(f"{said}: they stand for the images in the folder that end like them")

    def _find_home(self, paths: list[PurePosixPath], where: object) -> None:
        stated = {str(path.parent) for path in paths if not leaves(path)}
        if len(stated) != 1 or files.inside(self._folder, *stated, where=where).is_dir():
            return
        there = (one.name for one in homes(self._folder) if any(self._listing.like(one, path.name) for path in paths))
        if (name := next(there, None)) is not None:
            self._home = PurePosixPath(name)
            self.notes.append(f"there is no folder {' '.join(stated)}: images are taken from {name}")

    def path(self, file_path: str, *, where: object) -> Path | None:
        """The existing image of a `file_path`; None if there is none. Raises DatasetError if it cannot be a file's name."""
        stated = plain(file_path)
        if self._home is not None:
            path = files.inside(self._folder, str(self._home / stated.name), where=where)
        elif leaves(stated):
            return _ending_like(self._folder, stated, self._listing) or self._in_a_home(stated.name)
        else:
            path = files.inside(self._folder, str(stated), where=where)
        return path if path.is_file() else self._listing.like(path.parent, path.name)

    def _in_a_home(self, name: str) -> Path | None:
        """The image of a name in the first folder of images that has one, or beside the file."""
        found = (self._listing.like(home, name) for home in (*homes(self._folder), self._folder))
        return next((path for path in found if path is not None), None)


def _ending_like(folder: Path, path: PurePosixPath, listing: Listing) -> Path | None:
    """The file in the folder with the longest end of a path; its suffix may differ if it is an image."""
    parts = path.parts
    for first in range(len(parts) - 1):
        end = PurePosixPath(*parts[first:])
        if not leaves(end):
            wanted = files.inside(folder, str(end))
            if wanted.is_file():
                return wanted
            if (found := listing.like(wanted.parent, wanted.name)) is not None:
                return found
    return None
