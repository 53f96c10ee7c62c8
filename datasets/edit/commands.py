"""The `datasets` commands that make scenes from scenes: `edit` and `merge`; `datasets.cli` registers them."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from koala3d.datasets.core import console, options
from koala3d.datasets.core.help import MAIN, App
from koala3d.datasets.core.options import DataRoot, Json, OutFolder
from koala3d.datasets.process.commands import Length, MarkerSide, Positions, Up, evidence, wishes_of

if TYPE_CHECKING:
    from koala3d.datasets.process.world.alignment import Wishes
    from koala3d.datasets.scene import Scene

POSES, VIEWS, PICTURES = "Poses, by the pictures", "Views", "Pictures, in this order"
Change = Callable[["Scene", Path, Callable[[], None]], "Scene"]

Refine = Annotated[
    bool,
    typer.Option(
        "--refine-poses", help="Adjust poses to the pictures, if held-out points then fit better.", rich_help_panel=POSES
    ),
]
ArmMm = Annotated[float, typer.Option(min=1e-6, help="Accuracy of the positions per axis [mm].", rich_help_panel=POSES)]
ArmDeg = Annotated[float, typer.Option(min=1e-6, help="Accuracy of the orientations per axis [deg].", rich_help_panel=POSES)]
EnoughPx = Annotated[float, typer.Option(min=0, help="Keep poses whose median error is below this [px].", rich_help_panel=POSES)]
Keep = Annotated[str, typer.Option(help="Names of the views to keep, with the wildcards * and ?.", rich_help_panel=VIEWS)]
Every = Annotated[int, typer.Option(help="Keep every Nth of these views.", metavar="N", min=1, rich_help_panel=VIEWS)]
Splits = Annotated[str, typer.Option(help="Splits to keep, separated by commas.", rich_help_panel=VIEWS)]
HoldOut = Annotated[
    int | None,
    typer.Option(help="Every Nth view by sorted name becomes a test view.", metavar="N", min=1, rich_help_panel=VIEWS),
]
Test = Annotated[str, typer.Option(help="Names of the test views instead, with the wildcards * and ?.", rich_help_panel=VIEWS)]
Val = Annotated[str, typer.Option(help="Names of the validation views, with the wildcards * and ?.", rich_help_panel=VIEWS)]
Undistort = Annotated[
    bool,
    typer.Option("--undistort", help="Resample every picture to a centred pinhole camera.", rich_help_panel=PICTURES),
]
Crop = Annotated[
    tuple[int, int, int, int] | None,
    typer.Option(metavar="LEFT TOP WIDTH HEIGHT", help="Cut one rectangle out of every picture [px].", rich_help_panel=PICTURES),
]
Downscale = Annotated[
    int | None, typer.Option(metavar="N", min=2, help="Divide width and height by this factor.", rich_help_panel=PICTURES)
]


def add_to(app: App) -> None:
    """Register the commands."""
    for command in (edit, merge):
        app.command(panel=MAIN)(command)


@dataclass
class Edit:
    """What one call of `datasets edit` changes, in the order of the methods; each tells about itself in `facts` and `lines`."""

    facts: dict[str, Any]
    lines: list[str]

    def world(self, scene: "Scene", wishes: "Wishes") -> "Scene":
        """Unit and direction."""
        from koala3d.datasets.process.pictures import features
        from koala3d.datasets.process.world import alignment

        seen = {}
        with console.progress("markers", len(scene.views), "views") as shown:
            for view in scene.views:
                seen[view.name] = features.markers_of(view.image)
                shown.advance()
        found = alignment.align(scene, seen, wishes)
        self.facts |= {"metric": found.scene.metric, "scale_from": found.scale_from, "up_from": found.up_from}
        self.facts["hint"] = found.hint
        self.lines += evidence(found)
        return found.scene

    def poses(self, scene: "Scene", arm_mm: float, arm_deg: float, enough_px: float) -> "Scene":
        """Bundle adjustment."""
        import math

        from koala3d.datasets.edit.refine import Prior, refined

        found = refined(scene, Prior(1e-3 * arm_mm, math.radians(arm_deg)), enough_px=enough_px)
        self.facts["poses"] = found.to_json()
        moved = f"they moved by {found.moved_mm:.3f} mm, {found.moved_deg:.4f} deg rms" if found.used else "they are unchanged"
        self.lines.append(f"poses   {found.reason}; {moved}")
        return found.scene


def edit(
    scene: options.Scene,
    out: OutFolder,
    marker_mm: MarkerSide = None,
    known_length: Length = None,
    positions: Positions = None,
    up: Up = "",
    refine_poses: Refine = False,
    arm_mm: ArmMm = 0.05,
    arm_deg: ArmDeg = 0.01,
    enough_px: EnoughPx = 0.5,
    keep: Keep = "*",
    every: Every = 1,
    splits: Splits = "train,val,test",
    hold_out: HoldOut = None,
    test: Test = "",
    val: Val = "",
    undistort: Undistort = False,
    crop: Crop = None,
    downscale: Downscale = None,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write a changed copy of a scene: its unit, poses, views, splits or pictures.

    What is asked for is done in the order of the options below. A new unit or direction leaves ground truth out."""
    from koala3d.datasets.edit import edit as edits

    chosen = _splits(splits)
    moves = any((marker_mm, known_length, positions, up))
    wishes = wishes_of(marker_mm, known_length, positions, up or "auto") if moves else None
    made = Edit({}, [])

    def change(scene: "Scene", folder: Path, done: Callable[[], None]) -> "Scene":
        if wishes is not None:
            scene = made.world(scene, wishes)
        if refine_poses:
            scene = made.poses(scene, arm_mm, arm_deg, enough_px)
        scene = edits.subset(scene, keep=keep, every=every, splits=chosen)
        if hold_out or test or val:
            scene = edits.split(scene, every=hold_out or 8, test=test, val=val)
        if undistort:
            scene = edits.undistorted(scene, folder / "undistorted", done=done)
        if crop:
            scene = edits.cropped(scene, *crop, folder / "cropped", done=done)
        return edits.downscaled(scene, downscale, folder / "smaller", done=done) if downscale else scene

    _write(scene, out, data_root, as_json, change, made, any_lens=undistort and not (moves or refine_poses), moved=moves)


def _splits(text: str) -> list[str]:
    """The splits of a list. Raises UsageError for one that there is not."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.datasets.scene import SPLITS

    chosen = [word.strip() for word in text.split(",") if word.strip()]
    for word in chosen:
        if word not in SPLITS:
            raise UsageError(f"no split called {word!r}", remedy=nearest(word, SPLITS))
    return chosen


def merge(
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE", help="Scenes that share a coordinate frame.")],
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


def _write(
    name: str,
    out: Path,
    data_root: Path | None,
    as_json: bool,
    change: Change,
    made: Edit | None = None,
    *,
    any_lens: bool = False,
    moved: bool = False,
) -> None:
    """Load a scene, change it, and write it as a Koala scene, all or nothing. A scene that `moved` loses its truth."""
    from koala3d.datasets.building.build import extra_truth
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
        koala.save(changed, out, extra=None if moved else extra_truth(find(name, data_root)))
    counts = changed.counts()
    sizes = sorted({(view.camera.width, view.camera.height) for view in changed.views})
    words = ", ".join(f"{count} {split}" for split, count in counts.items() if count)
    shown_sizes = ", ".join(f"{width}x{height}" for width, height in sizes[:4])
    lines = [*(made.lines if made else ()), f"{words} views of {shown_sizes} px written to {out}"]
    result = {"out": str(out), "views": counts, "sizes": sizes, **(made.facts if made else {})}
    console.report(result, as_json=as_json, text="\n".join(lines))
