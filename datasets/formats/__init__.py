"""Reading and writing of scenes in every format; `load_scene` detects the format of a folder."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError, nearest
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import blender, colmap, dtu, koala, llff, nerfstudio, sdfstudio
from koala3d.datasets.formats.assemble import CAMERAS_ALONE
from koala3d.datasets.formats.captures import bop, metashape, phones, reality
from koala3d.datasets.formats.finding.almost import explain
from koala3d.datasets.formats.links import Extra, plain_masks
from koala3d.datasets.scene import Scene

WRITTEN = {"koala": koala, "blender": blender, "nerfstudio": nerfstudio, "llff": llff, "dtu": dtu, "colmap": colmap}
"""Module of each format that is read and written, with `detect`, `load` and `save`."""
FORMATS = {**WRITTEN, "sdfstudio": sdfstudio, "metashape": metashape, "bop": bop, "realityscan": reality, "phone": phones}
"""Module of each format, with `detect` and `load`; the first that detects a folder reads it."""

WRITERS: dict[str, Callable[..., str]] = {
    **{name: module.save for name, module in WRITTEN.items()},
    "colmap-text": partial(colmap.save, text=True),
    "mipnerf360": partial(colmap.save, sizes=(2, 4, 8)),
}
"""Writer of each format, by name."""
SIZED = frozenset({"koala", "nerfstudio", "llff", "colmap", "colmap-text"})
"""Formats that can hold smaller copies of the images."""
LENSES = frozenset({"blender", "nerfstudio", "colmap", "metashape", "realityscan"})
"""Formats with lens models that our camera cannot hold."""
_UNFORESEEN = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, RecursionError, MemoryError)
"""What values of the wrong type raise inside a reader."""


def load_scene(
    path: str | Path,
    *,
    format: str | None = None,
    data_root: Path | None = None,
    hold_out: int = 8,
    images: str | None = None,
    problems: list[KoalaError] | None = None,
    measure: bool = False,
    any_lens: bool = False,
) -> Scene:
    """Read a scene's cameras and bounds; its images stay on disk until a view is read.

    Args:
        path: a folder, or a name such as "koala/gold_head" below the current folder, `data_root` or $KOALA_DATA.
        format: one of `FORMATS`; None to detect it.
        hold_out: where the files name no test views, every Nth view by sorted name is one; 0 for none.
        images: folder of the images to use, where there are several sizes ("images_8").
        measure: where a scene has neither masks nor surface points, measure box, near and far by matching and triangulating
            its images (some seconds); `Scene.bounds_from` names the evidence.
        any_lens: accept lenses that `Camera` cannot hold, for resampling the images.
        problems: a list that collects the errors of damaged views, which are then left out; None to raise them.

    Raises:
        UsageError: there is no such folder, or no known format in it.
        DatasetError: a file violates its format.
    """
    folder = find(path, data_root)
    if format is not None and format not in FORMATS:
        raise UsageError(f"no format called {format!r}", remedy=nearest(format, FORMATS))
    kind = format or detect(folder)
    lens = {"any_lens": True} if any_lens and kind in LENSES else {}
    try:
        scene = FORMATS[kind].load(folder, hold_out=hold_out, images_folder=images, problems=problems, **lens)
    except _UNFORESEEN as error:
        why, remedy = f"{type(error).__name__}: {str(error)[:200]}", "write it again, or state its real format"
        raise DatasetError(f"is no {kind} scene", where=folder, why=why, remedy=remedy) from error
    if images is not None:  # truth and sightings are of the full size
        scene = replace(scene, views=tuple(replace(view, truth={}) for view in scene.views), sightings=None)
    if measure and scene.points is None and scene.bounds_from.startswith(CAMERAS_ALONE):
        from koala3d.datasets.structure.measure import measured

        scene = measured(scene)
    return scene


def save_scene(
    scene: Scene, path: Path, format: str, *, sizes: Sequence[int] = (), extra: Extra = None, done: Step = ignore
) -> str:
    """Write a scene in one of the formats of `WRITERS`, all or nothing.

    Args:
        scene: what to write.
        path: folder that is missing or empty.
        format: name of the format.
        sizes: N for each folder `images_N` of images at 1/N of their size.
        extra: further files to include, by relative name.
        done: called after each view.

    Returns:
        One line on what the format cannot hold and what was done about it; empty where it holds everything.

    Raises:
        UsageError: there is no such format, it cannot hold `sizes`, or `path` is not empty.
        DatasetError: an image is missing or damaged, or a lens leaves no picture.
    """
    if format not in WRITERS:
        raise UsageError(f"cannot export to {format!r}", remedy=nearest(format, WRITERS))
    if sizes and format not in SIZED:
        raise UsageError(f"{format} cannot hold smaller images", remedy=f"sizes work with {', '.join(sorted(SIZED))}")
    if any(size < 2 for size in sizes):
        raise UsageError("sizes must be 2 or more", why=", ".join(map(str, sizes)))
    options: dict[str, Any] = {"sizes": tuple(sizes)} if sizes else {}
    with plain_masks(scene) as plain:
        return WRITERS[format](plain, path, extra=extra, done=done, **options)


def detect(folder: Path) -> str:
    """Name of a folder's format. Raises UsageError where it has none of them, with what is there and what is missing."""
    name = _detected(folder)
    if name is None:
        raise explain(folder, lambda inner: _detected(inner) is not None)
    return "colmap" if name == "llff" and colmap.is_whole(folder) else name  # mip-NeRF 360 has both; colmap holds more


def _detected(folder: Path) -> str | None:
    return next((name for name, module in FORMATS.items() if module.detect(folder)), None)


def find(path: str | Path, data_root: Path | None = None) -> Path:
    """The folder of a scene: below `data_root`, else `path` itself, else below $KOALA_DATA.

    Raises:
        UsageError: it is in none of them; the message lists all.
    """
    path = Path(path).expanduser()
    roots = [data_root, Path(), os.environ.get("KOALA_DATA")]
    candidates = [path] if path.is_absolute() else [Path(root) / path for root in roots if root is not None and root != ""]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    if path.is_file():
        raise UsageError("is a file, not a scene", where=path, remedy="give the folder that holds it")
    why = f"looked in {', '.join(str(c.absolute()) for c in candidates)}"
    remedy = f"{_neighbours(path.name, candidates)}or set --data-root or KOALA_DATA"
    raise UsageError("no such scene", where=path, why=why, remedy=remedy)


def _neighbours(name: str, candidates: Sequence[Path]) -> str:
    """Advice that names the most similar folder beside the candidates."""
    beside = {p.name for c in candidates if c.parent.is_dir() for p in c.parent.iterdir() if p.is_dir() and p.name[0] != "."}
    close = nearest(name, beside)
    return f"{close} " if beside and close.startswith("did") else "check the name, "
