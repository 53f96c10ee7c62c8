"""Which numbers of which file are the pose of which image.

Poses are in a file for each image, or in one file of all: a table (`pose_table`), plain numbers (`pose_text`), or YAML, JSON and
OpenCV's files, there as a list of entries {image: NAME, pose: NUMBERS}, as a mapping of image names to numbers, or as a list of
numbers alone. Poses without names are in the order of the images.
"""

import re
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from koala3d.calib.sessions import opencv_storage, pose_table, pose_text
from koala3d.calib.sessions.description import Description
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError

SUFFIXES = (".csv", ".txt", ".npy", ".yaml", ".yml", ".json", ".xml")


def matching(folder: Path, pattern: str) -> dict[str, Path]:
    """Files by what the * of the pattern stands for, in natural order: img_2 is before img_10.

    Raises DatasetError where the pattern leaves the folder.
    """
    pattern = str(PurePosixPath(pattern))
    files.inside(folder, pattern, where=f"description, {pattern}")
    before, after = pattern.split("*")
    names = {path.relative_to(folder).as_posix(): path for path in folder.glob(pattern)}
    found = {name[len(before) : len(name) - len(after)]: path for name, path in names.items()}
    return dict(sorted(found.items(), key=lambda item: natural(item[0])))


def natural(name: str) -> tuple[list[tuple[bool, int, str]], str]:
    """Key that sorts names by their words and numbers."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(False, int(part), "") if part[0] in "0123456789" else (True, 0, part) for part in parts], name


def numbers(folder: Path, description: Description, images: dict[str, Path]) -> dict[str, list[float]]:
    """The numbers of the poses by name of the view, in the order of `images`; those of other names are left out."""
    if "*" in description.poses:
        paths = matching(folder, description.poses)
        found = {name: _read(paths[name], description, images) for name in images if name in paths}
    else:
        path = files.inside(folder, description.poses, where="description, poses")
        poses = _listed(_read(path, description, images), path)
        found = _in_order(poses, images, path) if isinstance(poses, list) else _by_name(poses, images)
    return {name: _plain(found[name], f"{folder}, view {name}") for name in found}


def _plain(pose: Any, where: str) -> list[float]:
    """A pose as a list of numbers. Raises DatasetError where it is something else."""
    pose = opencv_storage.rows(pose, where=where)
    try:
        return list(np.asarray(pose, np.float64).ravel().tolist())
    except (TypeError, ValueError, OverflowError):
        remedy = f"say where its numbers are, for instance key: {next(iter(pose))}" if isinstance(pose, dict) and pose else ""
        raise DatasetError("pose is not made of numbers", where=where, why=str(pose)[:80], remedy=remedy) from None


def _read(path: Path, description: Description, images: dict[str, Path]) -> Any:
    """What a file of poses holds: numbers in order, numbers by name, or whatever a YAML or JSON file has at the key."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return pose_table.read(path, description)
    if suffix == ".txt":
        return pose_text.read_lines(path, description, _names(images))
    if suffix == ".npy":
        return pose_text.read_npy(path, description)
    if suffix == ".json":
        return _at(description.key, files.read_json(path), path)
    if suffix == ".xml":
        return _at(description.key, opencv_storage.read_xml(path), path)
    if suffix in SUFFIXES:
        return _at(description.key, opencv_storage.read_yaml(path), path)
    why, remedy = (
        f"{suffix or 'no suffix'}; possible are {' '.join(SUFFIXES)}",
        "save the poses as one of these and correct 'poses'",
    )
    raise UsageError("is no file of poses", where=path, why=why, remedy=remedy)


def _at(key: str, content: Any, path: Path) -> Any:
    """What a file with this content holds at a key."""
    for part in key.split(".") if key else []:
        if not isinstance(content, dict) or part not in content:
            keys = sorted(map(str, content)) if isinstance(content, dict) else "no mapping"
            raise DatasetError(f"no key {part!r}", where=path, why=f"it has {keys}", remedy="correct 'key'")
        content = content[part]
    return content


def _listed(content: Any, path: Path) -> dict[str, Any] | list[Any]:
    """Numbers by image name from a list of entries or from a mapping; from a list of numbers alone, numbers in order."""
    content = opencv_storage.rows(content, where=path)
    if isinstance(content, dict):
        return {str(name): values for name, values in content.items()}
    if isinstance(content, list) and content and all(isinstance(entry, list) for entry in content):
        return content
    try:
        return {str(entry["image"]): entry["pose"] for entry in content}
    except (TypeError, KeyError) as error:
        why, remedy = f"{type(error).__name__} {error}", "write entries {image: NAME, pose: [...]}"
        raise DatasetError("is no list of poses", where=path, why=why, remedy=remedy) from None


def _names(images: dict[str, Path]) -> set[str]:
    """What a list of poses may call the images."""
    return {name for view, file in images.items() for name in (view, file.name, file.stem)}


def _by_name(poses: dict[str, Any], images: dict[str, Path]) -> dict[str, Any]:
    """Poses by name of the view, out of poses by name of the image or of the view."""
    views = {name: view for view, file in images.items() for name in (file.stem, file.name)}
    found = {views.get(Path(image).name, image): numbers for image, numbers in poses.items()}
    return {name: found[name] for name in images if name in found}


def _in_order(poses: list[Any], images: dict[str, Path], path: Path) -> dict[str, Any]:
    """Poses by name of the view, out of a list in the order of the images. The last images may have none."""
    if len(poses) > len(images):
        why, remedy = f"{len(poses)} for {len(images)} pictures", "remove those whose pictures are missing, or name the images"
        raise UsageError("there are more poses than pictures", where=path, why=why, remedy=remedy)
    return dict(zip(images, poses, strict=False))
