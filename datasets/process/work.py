"""The folder beside a scene in the making: every finished step is kept there until the scene is complete.

OUT.work/request.json   what the work is about; other pictures start it anew, other choices its second half
OUT.work/frames/        those chosen from a video
OUT.work/upright/       copies of photographs that were stored in another orientation
OUT.work/features/      features of each picture
OUT.work/matches.db     pycolmap's database
OUT.work/images/        the pictures, named by number
OUT.work/sparse/0/      the model
"""

import shutil
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError

FORMAT, VERSION = "koala-process", 1
REQUEST = "request.json"


class Work:
    """The work folder of one scene."""

    def __init__(self, out: Path) -> None:
        self.folder = out.with_name(f"{out.name}.work")
        self.frames = self.folder / "frames"
        self.upright = self.folder / "upright"
        self.features = self.folder / "features"
        self.database = self.folder / "matches.db"
        self.images = self.folder / "images"
        self.model = self.folder / "sparse" / "0"

    def start(self, pictures: list[Any], choices: list[Any]) -> bool:
        """Make the folder, or continue with what it holds of the same work; True where it continues.

        Args:
            pictures: what frames and features follow from.
            choices: what matches and poses follow from, besides.

        Raises:
            UsageError: there is something else in its place.
        """
        path = self.folder / REQUEST
        request = {"format": FORMAT, "version": VERSION, "pictures": pictures, "choices": choices}
        known = files.read_json(path, kind=FORMAT) if path.is_file() else {}
        same = {key: known.get(key) == request[key] for key in ("version", "pictures", "choices")}
        if known and not (same["version"] and same["pictures"]):
            self.remove()
        elif known and not same["choices"]:
            shutil.rmtree(self.model.parent, ignore_errors=True)
            self.database.unlink(missing_ok=True)
        elif known:
            return True
        if not path.is_file() and self.folder.exists():
            self._refuse()
        files.make_folder(self.folder)
        files.write_json(path, request)
        return False

    def _refuse(self) -> None:
        """Raise UsageError where the folder holds something of another origin."""
        if any(self.folder.iterdir()):
            why = "it was not made by 'datasets process'"
            raise UsageError("is in the way", where=self.folder, why=why, remedy="rename it, or choose another --out")

    def remove(self) -> None:
        """Remove the folder with everything in it."""
        shutil.rmtree(self.folder)


def state(path: Path) -> list[Any]:
    """What changes when a file does: name, size, time of the last change [ns]. Raises UsageError where there is none."""
    if not path.is_file():
        raise UsageError("no such file", where=path, remedy=files.neighbour(path, path.suffix))
    found = path.stat()
    return [path.name, found.st_size, found.st_mtime_ns]
