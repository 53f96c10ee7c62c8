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
    import numpy as np
    from numpy.typing import NDArray

    from koala3d.datasets.process.world.alignment import Wishes
    from koala3d.datasets.scene import Scene
    from koala3d.datasets.turned.registration import Registration

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


Turned = Annotated[bool, typer.Option("--turned", help="The second scene shows the object after a person turned it over.")]
Rough = Annotated[
    tuple[float, float, float] | None,
    typer.Option(
        metavar="X Y Z", help="With --turned: roughly the rotation vector from the second scene to the first [deg]: 180 0 0."
    ),
]
Points = Annotated[
    Path | None,
    typer.Option(help="With --turned: a text file with a line for each of three points of the object, x y z in both scenes."),
]
Motion = Annotated[
    Path | None,
    typer.Option(
        help="With --turned: shape.json of 'reconstruct compare-shape B A --align features'; outlines are then not compared."
    ),
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

    def turned(
        self, a: "Scene", b: "Scene", out: Path, start: "NDArray[np.float64] | None", known: "Registration | None"
    ) -> "Scene":
        """Both sessions of an object that was turned over in between; see `registered` and `placed`."""
        from koala3d.datasets.edit.turned import joined
        from koala3d.datasets.scene import TURNED
        from koala3d.datasets.turned.registration import placed, registered, starts_of

        if known is not None:
            found = placed(a, b, known)
        else:
            with console.progress("poses", len(starts_of(start)), "starts") as shown:
                found = registered(a, b, start, done=shown.advance)
        both = joined(a, b, found, out.resolve().name)
        shift, turn = found.deviations
        self.facts[TURNED] = {**both.provenance[TURNED], "deviations": {"shift": shift, "turn_rad": turn}}
        self.lines.append(f"turned  {both.notes[-1]}")
        return both


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
    scenes: Annotated[list[str], typer.Argument(metavar="SCENE", help="Scenes that share a coordinate frame, or two sessions.")],
    out: OutFolder,
    turned: Turned = False,
    rough: Rough = None,
    points: Points = None,
    motion: Motion = None,
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Write one scene with the views of several that share a coordinate frame.

    With --turned: of two sessions of an object that was turned over in between. How, is found by the outlines of its masks."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.edit import edit
    from koala3d.datasets.edit.turned import by_surfaces
    from koala3d.datasets.formats import load_scene
    from koala3d.datasets.formats.links import plain_masks

    if turned and len(scenes) != 2:
        raise UsageError("an object is turned over between two sessions", where="--turned", why=f"{len(scenes)} scenes are given")
    said = {"--rough": rough, "--points": points, "--motion": motion}
    if given := [name for name, value in said.items() if value is not None]:
        if not turned:
            raise UsageError("is for an object that was turned over", where=given[0], remedy="add --turned, or leave it out")
        if len(given) > 1:
            raise UsageError(f"says the same as {given[1]}", where=given[0], remedy="leave one of them out")
    start, known, made = _start(rough, points), None if motion is None else by_surfaces(motion), Edit({}, [])
    with ExitStack() as stack:
        others = [stack.enter_context(plain_masks(load_scene(name, data_root=data_root))) for name in scenes[1:]]
        if turned:
            return _write(scenes[0], out, data_root, as_json, lambda s, *_: made.turned(s, others[0], out, start, known), made)
        _write(scenes[0], out, data_root, as_json, lambda s, folder, done: edit.merge([s, *others], out.resolve().name))


def _start(rough: tuple[float, float, float] | None, points: Path | None) -> "NDArray[np.float64] | None":
    """How the object was moved, as a person says it. Raises UsageError or DatasetError where that means nothing."""
    if rough is not None:
        import numpy as np

        from koala3d.datasets import pose

        return pose.from_rotation_vector(np.deg2rad(rough))[:3, :3]
    if points is None:
        return None
    from koala3d.datasets.core.errors import DatasetError
    from koala3d.datasets.edit.turned import by_points

    try:
        rows = [[float(word) for word in line.replace(",", " ").split()] for line in points.read_text("utf-8").splitlines()]
        return by_points([row for row in rows if row])
    except (OSError, ValueError) as error:
        raise DatasetError("points cannot be read", where=points, why=str(error)) from None


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
