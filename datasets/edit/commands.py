"""The `datasets` commands that make scenes from scenes; `datasets.cli` registers them."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from koala3d.datasets.core import console, options
from koala3d.datasets.core.help import App
from koala3d.datasets.core.options import DataRoot, Json, OutFolder

if TYPE_CHECKING:
    from koala3d.datasets.scene import Scene

Edit = Callable[["Scene", Path, Callable[[], None]], "Scene"]


def add_to(app: App) -> None:
    """Register the commands."""
    for command in (subset, split, merge, downscale, undistort, crop):
        app.command()(command)


def subset(
    scene: options.Scene,
    out: OutFolder,
    keep: Annotated[str, typer.Option(help="Names of the views to keep, with the wildcards * and ?.")] = "*",
    every: Annotated[int, typer.Option(help="Keep every Nth of these views.", metavar="N", min=1)] = 1,
    splits: Annotated[str, typer.Option(help="Splits to keep, separated by commas.")] = "train,val,test",
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene with a part of the views of another."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.datasets.edit import edit
    from koala3d.datasets.scene import SPLITS

    chosen = [word.strip() for word in splits.split(",") if word.strip()]
    for word in chosen:
        if word not in SPLITS:
            raise UsageError(f"no split called {word!r}", remedy=nearest(word, SPLITS))
    _write(scene, out, data_root, as_json, lambda s, folder, done: edit.subset(s, keep=keep, every=every, splits=chosen))


def split(
    scene: options.Scene,
    out: OutFolder,
    every: Annotated[int, typer.Option(help="Every Nth view by sorted name is a test view.", metavar="N")] = 8,
    test: Annotated[str, typer.Option(help="Names of the test views instead, with the wildcards * and ?.")] = "",
    val: Annotated[str, typer.Option(help="Names of the validation views, with the wildcards * and ?.")] = "",
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene with a new division of its views into training and test."""
    from koala3d.datasets.edit import edit

    _write(scene, out, data_root, as_json, lambda s, folder, done: edit.split(s, every=every, test=test, val=val))


def merge(
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE...", help="Scenes that share a coordinate frame.")],
    out: OutFolder,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write one scene with the views of several that share a coordinate frame."""
    from koala3d.datasets.edit import edit
    from koala3d.datasets.formats import load_scene
    from koala3d.datasets.formats.links import plain_masks

    with ExitStack() as stack:
        others = [stack.enter_context(plain_masks(load_scene(name, data_root=data_root))) for name in scenes[1:]]
        _write(scenes[0], out, data_root, as_json, lambda s, folder, done: edit.merge([s, *others], out.resolve().name))


def downscale(
    scene: options.Scene,
    out: OutFolder,
    factor: Annotated[int, typer.Option(help="Divide width and height by this factor.")],
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene with smaller images."""
    from koala3d.datasets.edit import edit

    _write(scene, out, data_root, as_json, lambda s, folder, done: edit.downscaled(s, factor, folder, done=done))


def undistort(scene: options.Scene, out: OutFolder, data_root: DataRoot = None, as_json: Json = False) -> None:
    """Write a scene with every image resampled to a centred pinhole camera."""
    from koala3d.datasets.edit import edit

    _write(scene, out, data_root, as_json, lambda s, folder, done: edit.undistorted(s, folder, done=done), any_lens=True)


def crop(
    scene: options.Scene,
    out: OutFolder,
    width: Annotated[int, typer.Option(help="Width of the result [px].")],
    height: Annotated[int, typer.Option(help="Height of the result [px].")],
    left: Annotated[int, typer.Option(help="Columns to remove at the left [px].")] = 0,
    top: Annotated[int, typer.Option(help="Rows to remove at the top [px].")] = 0,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a scene with every image cropped to one rectangle."""
    from koala3d.datasets.edit import edit

    _write(scene, out, data_root, as_json, lambda s, folder, done: edit.cropped(s, left, top, width, height, folder, done=done))


def _write(name: str, out: Path, data_root: Path | None, as_json: bool, change: Edit, *, any_lens: bool = False) -> None:
    """Load a scene, change it, and write it as a Koala scene, all or nothing."""
    from koala3d.datasets.build import extra_truth
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.datasets.formats import find, koala, load_scene
    from koala3d.datasets.formats.links import plain_masks

    refuse_existing(out)
    loaded = load_scene(name, data_root=data_root, any_lens=any_lens)
    out.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as work,
        plain_masks(loaded) as plain,
        console.progress("writing", len(loaded.views), "views") as shown,
    ):
        changed = change(plain, Path(work), shown.advance)
        koala.save(changed, out, extra=extra_truth(find(name, data_root)))
    counts = changed.counts()
    sizes = sorted({(view.camera.width, view.camera.height) for view in changed.views})
    words = ", ".join(f"{count} {split}" for split, count in counts.items() if count)
    shown_sizes = ", ".join(f"{width}x{height}" for width, height in sizes[:4])
    text = f"{words} views of {shown_sizes} px written to {out}"
    console.report({"out": str(out), "views": counts, "sizes": sizes}, as_json=as_json, text=text)
