"""The photographs of a folder, sorted by name, and which of them were taken by one camera."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.process.pictures import exif
from koala3d.datasets.scene import checked_name

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff"})
SHARING = ("auto", "size", "each")
"""Which photographs share a camera: those of one size, maker, model and focal length; those of one size; none."""
FEWEST = 3
"""Smallest number of pictures from which poses are estimated."""


@dataclass(frozen=True)
class Photograph:
    """One picture. Its size is that of the upright one."""

    name: str
    """Of the view: the file's name without its suffix, unless two files share that."""
    path: Path
    width: int
    height: int
    lens: tuple[str, ...] = ()
    """What it has in common with the other pictures of its camera."""
    focal_px: float | None = None
    """Focal length by its header; None where it states none."""
    is_upright: bool = True
    """False if its EXIF orientation says that the stored pixels are to be turned."""


@dataclass(frozen=True)
class Photographs:
    """The photographs of a folder."""

    photographs: tuple[Photograph, ...]
    damaged: dict[str, str]
    """Why a picture cannot be read, by file name."""
    ignored: tuple[str, ...]
    """Names of the files that are no pictures."""


def find(folder: Path) -> Photographs:
    """The pictures of a folder, their headers read.

    Raises:
        UsageError: there is no such folder, or it holds too few pictures.
    """
    if not folder.is_dir():
        raise UsageError("no such folder or video", where=folder, remedy="check the path")
    inside = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    paths = [path for path in inside if path.suffix.lower() in SUFFIXES]
    if len(paths) < FEWEST:
        raise _too_few(folder, inside, paths)
    stems = Counter(path.stem for path in paths)
    photographs, damaged = [], {}
    for path in paths:
        name = path.stem if stems[path.stem] == 1 else f"{path.stem}_{path.suffix[1:]}"
        try:
            (width, height), header, turn = images.size(path), images.metadata(path), images.orientation(path)
        except DatasetError as error:
            damaged[path.name] = f"{error.what}: {error.why}"
            continue
        focal = exif.focal_length(header, width, height)
        if turn >= 5:
            width, height = height, width
        name = checked_name(name, where=path)
        photographs.append(Photograph(name, path, width, height, exif.lens(header), focal, turn == 1))
    if len(photographs) < FEWEST:
        why = f"{len(damaged)} of {len(paths)} pictures cannot be read, such as {next(iter(damaged))}"
        raise UsageError("too few pictures can be read", where=folder, why=why, remedy="copy them again")
    return Photographs(tuple(photographs), damaged, tuple(path.name for path in inside if path not in paths))


def cameras(photographs: tuple[Photograph, ...], sharing: str) -> list[int]:
    """Number of the camera of each photograph, from 0; `sharing` is one of `SHARING`."""
    known: dict[tuple[object, ...], int] = {}
    result = []
    for photograph in photographs:
        key: tuple[object, ...] = (photograph.width, photograph.height)
        if sharing == "auto":
            key += photograph.lens
        elif sharing == "each":
            key = (photograph.name,)
        result.append(known.setdefault(key, len(known)))
    return result


def _too_few(folder: Path, inside: list[Path], pictures: list[Path]) -> UsageError:
    """What a folder without enough pictures holds instead, and what to do."""
    why = f"{len(pictures)} pictures, {FEWEST} are needed; suffixes read are {', '.join(sorted(SUFFIXES))}"
    below = [path for path in sorted(folder.iterdir()) if path.is_dir() and not path.name.startswith(".")]
    below = [path for path in below if sum(p.suffix.lower() in SUFFIXES for p in path.iterdir()) >= FEWEST]
    others = Counter(path.suffix.lower() for path in inside if path not in pictures)
    if below:
        remedy = f"give {below[0]}"
    elif others:
        suffix, count = others.most_common(1)[0]
        remedy = f"it holds {count} files {suffix or 'without a suffix'}: convert them to JPEG or PNG"
    else:
        remedy = "check the path"
    return UsageError("too few photographs", where=folder, why=why, remedy=remedy)
