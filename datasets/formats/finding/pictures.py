"""Where the images of a folder are: programs call their folder `images`, `image` or `rgb`, and change suffixes and their case."""

import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path, PurePath

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError

PICTURES = frozenset({".jpg", ".jpeg", ".png", ".exr", ".tif", ".tiff"})
"""Suffixes of images, in lower case."""
HOMES = ("images", "image", "rgb", "rgbs", "color", "imgs", "img", "photos", "frames", "input")
"""Names of folders of images, the usual one first; a number after them says how many times smaller the images are."""
_SIZED = re.compile(rf"({'|'.join(HOMES)})_(\d+)", re.IGNORECASE)
_WORD = "(?:mask|alpha|matte|depth|normals?|disp)s?"
_COMPANION = re.compile(rf"(?:(.+)[._-]{_WORD}|{_WORD}[._-](.+))", re.IGNORECASE)
"""Stem of a picture beside an image that is no photograph itself, such as `X_mask` beside `X`."""


def without_suffix(path: PurePath) -> str:
    """A path without the suffix of a picture; other dots belong to the name, as those of time stamps do."""
    return (path.with_suffix("") if path.suffix.lower() in PICTURES else path).as_posix()


class Listing:
    """Names of the files in folders, each folder listed once; suffix, case and Unicode form may differ from the name sought."""

    def __init__(self) -> None:
        self._known: dict[Path, dict[str, list[Path]]] = {}

    def files(self, folder: Path) -> list[Path]:
        """The image files of a folder by sorted names, hidden ones left out; none where there is no such folder."""
        return sorted({path for paths in self._index(folder).values() for path in paths})

    def like(self, folder: Path, name: str) -> Path | None:
        """The image of this name, of any case, or else of this stem with another suffix, PNG preferred; None for none."""
        wanted = Path(name)
        index = self._index(folder / wanted.parent)
        stem = wanted.stem if wanted.suffix.lower() in PICTURES else wanted.name
        found = index.get(_key(wanted.name)) or index.get(_key(stem) + ".")
        return min(found, key=_preference) if found else None

    def named_after(self, folder: Path, name: str) -> Path | None:
        """The image named after `X.JPG`: `X.JPG.png`, `X.png`, `X.jpg`, `X_mask.png` or `mask_X.png`; PNG is preferred."""
        other = Path(name)
        index = self._index(folder / other.parent)
        stem = _key(other.stem)
        for key in (_key(other.name), stem, f"{stem}_mask", f"{stem}.mask", f"{stem}-mask", f"mask_{stem}", f"{stem}_alpha"):
            if found := index.get(key + "."):
                return min(found, key=_preference)
        return None

    def _index(self, folder: Path) -> dict[str, list[Path]]:
        """Image files by the key of their name, and by that of their stem with a full stop."""
        if folder not in self._known:
            index: dict[str, list[Path]] = {}
            for path in sorted(folder.iterdir()) if folder.is_dir() else ():
                if path.suffix.lower() in PICTURES and path.name[0] != ".":
                    index.setdefault(_key(path.name), []).append(path)
                    index.setdefault(_key(path.stem) + ".", []).append(path)
            self._known[folder] = index
        return self._known[folder]


def _key(name: str) -> str:
    """What names have in common that differ in case, or in how an accent is written: a Mac takes letter and accent apart."""
    return unicodedata.normalize("NFC", name).lower()


def _preference(path: Path) -> tuple[bool, str]:
    return path.suffix.lower() != ".png", path.name


def homes(folder: Path) -> list[Path]:
    """Folders of images: those of full size in the order of `HOMES`, then the smaller ones, the largest first."""
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    full = sorted((p for p in inner if p.name.lower() in HOMES), key=lambda p: HOMES.index(p.name.lower()))
    sized = [(int(match[2]), path) for path in inner if (match := _SIZED.fullmatch(path.name))]
    return [*full, *(path for _, path in sorted(sized))]


def find(folder: Path, wanted: str | None = None) -> tuple[list[Path], str]:
    """Sorted images and the name of their folder: `wanted`, else the first of `homes` that holds images.

    Raises:
        UsageError: there is no such folder.
        DatasetError: it holds no images.
    """
    offered = homes(folder)
    if wanted is not None:
        offered = [path for path in [files.inside(folder, wanted)] if path.is_dir()]
    if not offered:
        there = ", ".join(sorted(path.name for path in folder.iterdir() if path.is_dir())[:8])
        why, remedy = f"there are the folders {there}" if there else "", "put the images there"
        if wanted is None and (videos := sorted(folder.glob("*.mp4"))):
            why = f"there are {len(videos)} videos such as {videos[0].name}"
            remedy = f"put a frame of each there: ffmpeg -i {videos[0].name} -frames:v 1 images/{videos[0].stem}.png"
        raise UsageError("no folder of images", where=folder / (wanted or HOMES[0]), why=why, remedy=remedy)
    for home in offered:
        if found := photographs(Listing().files(home)):
            return found, home.name
    raise DatasetError("scene has no images", where=offered[0], remedy="put the images there")


def photographs(found: Sequence[Path]) -> list[Path]:
    """The images less the masks and depth maps that are beside them (`X_mask.png` beside `X.png`)."""
    stems = {path.stem for path in found}
    companions = {path: _COMPANION.fullmatch(path.stem) for path in found}
    return [path for path, match in companions.items() if match is None or (match[1] or match[2]) not in stems]
