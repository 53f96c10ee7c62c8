"""Koala's own layout: everything that a scene knows, in one folder that is written whole or not at all.

SCENE/cameras.json   version, bounds, background, and for each view its camera, pose, split and files
SCENE/images/        as captured, never re-encoded (a hard link where the disk allows)
SCENE/masks/         where there are masks
SCENE/truth/         where there is ground truth: truth/<channel>/<view>.<suffix>, read by evaluation alone
"""

import errno
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets import files, pose
from datasets.camera_model import Camera
from datasets.errors import DatasetError, KoalaError
from datasets.formats import assemble, sidecar
from datasets.scene import SPLITS, Scene, View

FILE = "cameras.json"
FORMAT, VERSION = "koala-scene", 1
POINTS = "points.npz"


def detect(folder: Path) -> bool:
    """True for a folder with `cameras.json`."""
    return (folder / FILE).is_file()


def save(scene: Scene, path: Path, *, extra: Mapping[str, Path] | None = None, done: Callable[[], None] = lambda: None) -> str:
    """Write a scene folder, images included. `extra` maps further relative names to files to take along.

    Returns:
        What the layout cannot hold of the scene: nothing.

    Raises:
        Misuse: `path` holds something already.
    """
    with files.atomic_folder(path) as folder:
        views = []
        for view in scene.views:
            views.append(_saved_view(view, folder))
            done()
        for name, source in (extra or {}).items():
            link(source, folder / name)
        if scene.points is not None:
            np.savez_compressed(folder / POINTS, points=scene.points)
        files.write_json(folder / FILE, {"format": FORMAT, "version": VERSION, **sidecar.facts(scene), "views": views})
    return ""


def _saved_view(view: View, folder: Path) -> dict[str, Any]:
    name = file_name(view)

    def keep(source: Path, below: str) -> str:
        relative = f"{below}/{name}{source.suffix}"
        link(source, folder / relative)
        return relative

    return {
        "name": view.name, "split": view.split, "image": keep(view.image, "images"),
        "mask": keep(view.mask, "masks") if view.mask else None,
        "truth": {key: keep(source, f"truth/{key}") for key, source in view.truth.items()},
        "camera": view.camera.to_json(), "world_from_camera": view.world_from_camera.tolist(),
    }  # fmt: skip


def file_name(view: View) -> str:
    """A view's name as the name of a file."""
    return view.name.replace("/", "_")


def link(source: Path, target: Path) -> None:
    """Make `target` the same file as `source`: a hard link, or a copy where the disks differ. Refuses to overwrite."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists():
        raise DatasetError("two views would share a file", where=target, remedy="give each view its own name")
    try:
        os.link(Path(source).resolve(), target)
    except OSError:
        _copy(source, target)


def _copy(source: Path, target: Path) -> None:
    """Copy a file; a full disk is told of the target, where `shutil` would name the source."""
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise OSError(error.errno, error.strerror, str(target)) from None
        raise


def load(folder: Path, *, problems: list[KoalaError] | None = None) -> Scene:
    """Read a scene folder.

    Raises:
        DatasetError: a view or a bound is missing, damaged or impossible.
    """
    source = folder / FILE
    content = files.read_json(source, kind=FORMAT, version=VERSION)
    gathering = assemble.Gathering(folder, problems)
    views = content.get("views")
    if not isinstance(views, list):
        raise DatasetError("holds no list of views", where=source)
    for index, entry in enumerate(views):
        try:
            gathering.views.append(_loaded_view(entry, folder, where=f"{source}, view {index}"))
        except KoalaError as error:
            gathering.complain(error)
    scene = sidecar.scene_of(content, gathering.finished(listed_in=FILE), where=source)
    if not (folder / POINTS).is_file():
        return scene
    with np.load(folder / POINTS, allow_pickle=False) as stored:
        return replace(scene, points=stored["points"].astype(np.float64))


def _loaded_view(entry: Any, folder: Path, *, where: str) -> View:
    try:
        name, split = str(entry["name"]), entry["split"]
        where = f"{where} ({name})"
        image, mask = entry["image"], entry.get("mask")
        truth = {key: files.inside(folder, path, where=where) for key, path in entry.get("truth", {}).items()}
        camera = Camera.from_json(entry["camera"], where=f"{where}, camera")
        matrix = pose.checked(entry["world_from_camera"], where=f"{where}, world_from_camera")
    except (KeyError, TypeError, AttributeError) as error:
        raise DatasetError("view is not complete", where=where, why=f"{type(error).__name__} {error}") from None
    if split not in SPLITS:
        raise DatasetError(f"no split called {split!r}", where=where, remedy=f"valid: {', '.join(SPLITS)}")
    return View(name, camera, matrix, split, files.inside(folder, image, where=where),
                files.inside(folder, mask, where=where) if mask else None, truth)  # fmt: skip
