"""Scenes on disk, in every layout that Koala reads: `load_scene` finds out which one a folder has."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from datasets.core.errors import DatasetError, KoalaError, UsageError, nearest
from datasets.formats import assemble, blender, colmap, dtu, koala, llff, nerfstudio
from datasets.scene import Scene

FORMATS: dict[str, tuple[Callable[[Path], bool], Callable[..., Scene]]] = {
    "koala": (koala.detect, koala.load),
    "blender": (blender.detect, blender.load),
    "nerfstudio": (nerfstudio.detect, nerfstudio.load),
    "llff": (llff.detect, llff.load),
    "dtu": (dtu.detect, dtu.load),
    "colmap": (colmap.detect, colmap.load),
}
"""Name of each layout with its test and its reader; the first whose test says yes is taken."""

WRITERS: dict[str, Callable[..., str]] = {
    "koala": koala.save,
    "blender": blender.save,
    "nerfstudio": nerfstudio.save,
    "llff": llff.save,
    "dtu": dtu.save,
    "colmap": colmap.save,
    "colmap-text": partial(colmap.save, text=True),
    "mipnerf360": partial(colmap.save, sizes=(2, 4, 8)),
}
"""Name of each layout with its writer."""
SIZED = frozenset({"koala", "nerfstudio", "llff", "colmap", "colmap-text"})
"""Layouts that have room for smaller images."""


_UNFORESEEN = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, RecursionError, MemoryError)
"""What values of the wrong kind lead to, deep inside a reader."""


def load_scene(
    path: str | Path,
    *,
    format: str | None = None,
    data_root: Path | None = None,
    hold_out: int = 8,
    images: str | None = None,
    problems: list[KoalaError] | None = None,
    measure: bool = False,
) -> Scene:
    """Read a scene's cameras and bounds; its images stay on disk until a view is read.

    Args:
        path: a folder, or a name such as "koala/gold_head" below the current folder, `data_root` or $KOALA_DATA.
        format: one of `FORMATS`; None finds out.
        hold_out: where the files name no test views, every so-many-th by sorted name is one; 0 for none.
        images: folder of the images to use where a layout offers several sizes ("images_8").
        measure: where a scene has neither masks nor surface points, match and triangulate its pictures (some seconds), so
            that box, near and far are measured; `Scene.bounds_from` says with what evidence.
        problems: where a list is given, a damaged view is left out and its error put there; else it is raised.

    Raises:
        UsageError: no such folder, or nothing in it that Koala knows.
        DatasetError: a file does not hold what its layout promises.
    """
    folder = find(path, data_root)
    if format is not None and format not in FORMATS:
        raise UsageError(f"no format called {format!r}", remedy=nearest(format, FORMATS))
    kind = format or detect(folder)
    try:
        scene = FORMATS[kind][1](folder, hold_out=hold_out, images_folder=images, problems=problems)
    except _UNFORESEEN as error:
        raise DatasetError(
            f"is no {kind} scene",
            where=folder,
            why=f"{type(error).__name__}: {str(error)[:200]}",
            remedy="write it again, or give the format that it has",
        ) from error
    if images is not None:  # truth and sightings are of the full size
        scene = replace(scene, views=tuple(replace(view, truth={}) for view in scene.views), sightings=None)
    if measure and scene.points is None and scene.bounds_from.startswith(assemble.CAMERAS_ALONE):
        from datasets.structure.measure import measured

        scene = measured(scene)
    return scene


def save_scene(
    scene: Scene,
    path: Path,
    format: str,
    *,
    sizes: Sequence[int] = (),
    extra: dict[str, Path] | None = None,
    done: Callable[[], None] = lambda: None,
) -> str:
    """Write a scene in one of `WRITERS`' layouts, all or nothing.

    Args:
        scene: what to write.
        path: folder that is missing or empty.
        format: name of the layout.
        sizes: N for each folder `images_N` of images at 1/N of their size, where the layout has room for them.
        extra: further files to take along, by relative name.
        done: called after each view.

    Returns:
        One line on what the layout cannot hold, and what was done about it; empty where it holds everything.

    Raises:
        UsageError: no such layout, `path` holds something, or sizes for a layout without room.
        DatasetError: an image is missing or damaged, or a lens leaves no picture.
    """
    if format not in WRITERS:
        raise UsageError(f"cannot export to {format!r}", remedy=nearest(format, WRITERS))
    if sizes and format not in SIZED:
        raise UsageError(f"{format} has no room for smaller images", remedy=f"sizes go with {', '.join(sorted(SIZED))}")
    if any(size < 2 for size in sizes):
        raise UsageError("sizes are to be 2 or more", why=", ".join(map(str, sizes)))
    options: dict[str, Any] = {"sizes": tuple(sizes)} if sizes else {}
    return WRITERS[format](scene, path, extra=extra, done=done, **options)


def detect(folder: Path) -> str:
    """Name of the layout that a folder has. Raises UsageError where it has none of them."""
    for name, (matches, _) in FORMATS.items():
        if matches(folder):
            return "colmap" if name == "llff" and colmap.is_whole(folder) else name  # mip-NeRF 360 has both: a model says more
    raise UsageError(
        "holds no scene that Koala knows",
        where=folder,
        why="no cameras.json, transforms_*.json, transforms.json, poses_bounds.npy, cameras_sphere.npz or COLMAP model",
        remedy="give the folder that holds one of these",
    )


def find(path: str | Path, data_root: Path | None = None) -> Path:
    """The folder that `path` means: below `data_root`, else as it stands, else below $KOALA_DATA.

    Raises:
        UsageError: it is in none of them; the message lists where it was looked for.
    """
    path = Path(path).expanduser()
    roots = [data_root, Path(), os.environ.get("KOALA_DATA")]
    candidates = [path] if path.is_absolute() else [Path(root) / path for root in roots if root is not None and root != ""]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    if path.is_file():
        raise UsageError("is a file, not a scene", where=path, remedy="give the folder that holds it")
    raise UsageError(
        "no such scene",
        where=path,
        why=f"looked in {', '.join(str(c.absolute()) for c in candidates)}",
        remedy=f"{_neighbours(path.name, candidates)}or set --data-root or KOALA_DATA",
    )


def _neighbours(name: str, candidates: Sequence[Path]) -> str:
    """Advice that names the nearest folder beside those that were looked for."""
    beside = {p.name for c in candidates if c.parent.is_dir() for p in c.parent.iterdir() if p.is_dir() and p.name[0] != "."}
    close = nearest(name, beside)
    return f"{close} " if beside and close.startswith("did") else "check the name, "
