"""Where a folder keeps its COLMAP models; mappers write several where the images do not hang together."""

from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.colmap_files import count_images

PLACES = (
    "sparse/*", "sparse", "colmap/sparse/*", "colmap/sparse", "colmap",
    "dense/sparse", "dense/*/sparse", "distorted/sparse/*", "",
)  # fmt: skip
"""Folders of models in the order in which they are tried: of the mapper, of nerfstudio, of the undistorter, of 3D Gaussians."""
NEEDED, POINTS = ("cameras", "images"), "points3D"
"""Files of a model, without suffix. Points may be absent, as in models that are made of known poses, or be a PLY file."""


def find(folder: Path) -> tuple[list[Path], dict[Path, str]]:
    """Complete models in the order in which they are tried, the one with most images before its neighbours, and a note on those.

    Raises:
        DatasetError: there is a part of a model only.
    """
    found: list[Path] = []
    notes: dict[Path, str] = {}
    started = [path for pattern in PLACES for path in _matching(folder, pattern) if any(_present(path))]
    for pattern in PLACES:
        group = [path for path in _matching(folder, pattern) if _suffix(path)]
        if pattern.endswith("*") and len(group) > 1:
            group, note = _largest_first(folder, group)
            notes |= dict.fromkeys(group, note)
        found += group
    if started and not found:
        suffix = ".bin" if any((started[0] / f"{name}.bin").is_file() for name in NEEDED) else ".txt"
        absent = ", ".join(name + suffix for name, there in zip(NEEDED, _present(started[0], suffix), strict=True) if not there)
        remedy = "copy the whole model"
        raise DatasetError("COLMAP model is not complete", where=started[0], why=f"{absent} is missing", remedy=remedy)
    return found, notes


def _largest_first(folder: Path, group: list[Path]) -> tuple[list[Path], str]:
    counts = {path: count_images(files.within(folder, path / f"images{_suffix(path)}")) for path in group}
    ordered = sorted(group, key=lambda path: -counts[path])
    largest, *others = (f"{path.relative_to(folder)} has {counts[path]}" for path in ordered)
    return ordered, f"the largest of {len(group)} models is used: {largest} images, {', '.join(others)}"


def parts(place: Path) -> tuple[Path, Path, Path | None]:
    """The files of a complete model: cameras, images, and points if there are any; binary, or text if those are not complete."""
    suffix = _suffix(place)
    cameras, images = (place / (name + suffix) for name in NEEDED)
    points = (place / (POINTS + end) for end in (suffix, ".ply"))
    return cameras, images, next((path for path in points if path.is_file()), None)


def exists(folder: Path) -> bool:
    """True where the folder has the cameras of a model, complete or not."""
    return any(_present(path)[0] for pattern in PLACES for path in _matching(folder, pattern))


def _matching(folder: Path, pattern: str) -> list[Path]:
    """Folders that a place stands for; a star is one name."""
    above, star, below = pattern.partition("*")
    root = files.inside(folder, above)
    inner = sorted(path for path in root.iterdir() if path.is_dir()) if star and root.is_dir() else [] if star else [root]
    return [path / below.lstrip("/") for path in inner]


def _present(place: Path, *suffixes: str) -> list[bool]:
    return [any((place / (name + end)).is_file() for end in suffixes or (".bin", ".txt")) for name in NEEDED]


def _suffix(place: Path) -> str:
    """Suffix in which cameras and images are there; empty where there is none."""
    return next((end for end in (".bin", ".txt") if all(_present(place, end))), "")
