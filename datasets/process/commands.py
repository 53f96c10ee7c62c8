"""The commands `datasets process` and `compare`; `datasets.cli` registers them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from koala3d.datasets.core import console, options
from koala3d.datasets.core.help import CHECK, MAIN, App
from koala3d.datasets.core.options import DataRoot, Json, OutFolder

if TYPE_CHECKING:
    from koala3d.datasets.process.process import Processed
    from koala3d.datasets.process.world.alignment import Aligned, Wishes

POINT = "PICTURE:X,Y+PICTURE:X,Y"

WORLD, MODEL = "Unit and direction of the world", "How poses are found"

MarkerSide = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Printed side of the ArUco, AprilTag or ChArUco markers in view.", rich_help_panel=WORLD),
]
Length = Annotated[
    tuple[str, str, float] | None,
    typer.Option(
        metavar="A B METRES",
        help=f"A known distance between two points A and B, each written {POINT}.",
        rich_help_panel=WORLD,
    ),
]
Positions = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Measured positions of the camera or of the flange: lines of NAME X Y Z, in metres.",
        rich_help_panel=WORLD,
    ),
]
Up = Annotated[
    str,
    typer.Option(
        help="What tells the z axis: marker, plane, cameras, none; auto tries them in this order.", rich_help_panel=WORLD
    ),
]
Frames = Annotated[int, typer.Option(metavar="N", min=3, help="Most frames to take from a video.", rich_help_panel=MODEL)]
Match = Annotated[
    str,
    typer.Option(
        help="Pairs to match: all, neighbours (in order of names), alike, or auto, which depends on their number.",
        rich_help_panel=MODEL,
    ),
]
Vocabulary = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="COLMAP's vocabulary tree, to choose the pairs.", rich_help_panel=MODEL),
]
Cameras = Annotated[
    str,
    typer.Option(
        help="Pictures that share a lens: auto (size, maker, model and focal length), size, or each.", rich_help_panel=MODEL
    ),
]


def add_to(app: App) -> None:
    """Register the commands."""
    app.command(panel=MAIN)(process)
    app.command(panel=CHECK)(compare)


def process(
    source: Annotated[Path, typer.Argument(metavar="PHOTOS|VIDEO", help="Folder of photographs, or a video.")],
    out: OutFolder,
    frames: Frames = 100,
    match: Match = "auto",
    vocabulary: Vocabulary = None,
    cameras: Cameras = "auto",
    marker_mm: MarkerSide = None,
    known_length: Length = None,
    positions: Positions = None,
    up: Up = "auto",
    as_json: Json = False,
) -> None:
    """Make a posed scene from photographs or a video.

    If it is interrupted, the same command continues where it stopped."""
    from koala3d.datasets.process.pictures import photographs
    from koala3d.datasets.process.poses import pairs
    from koala3d.datasets.process.process import Request
    from koala3d.datasets.process.process import process as process_pictures

    _one_of("--match", match, pairs.KINDS)
    _one_of("--cameras", cameras, photographs.SHARING)
    wishes = wishes_of(marker_mm, known_length, positions, up)
    found = process_pictures(source, out, Request(frames, match, vocabulary, cameras), wishes)
    console.report({"scene": str(out), **_facts(found)}, as_json=as_json, text=f"{_text(found)}\nwritten to {out}")


def compare(
    scene: options.Scene,
    reference: Annotated[str, typer.Argument(metavar="REFERENCE", help="Scene of the same photographs with known poses.")],
    data_root: DataRoot = None,
    as_json: Json = False,
) -> None:
    """Compare the poses of two scenes of the same photographs.

    Photographs may have been renamed. Unit, origin and orientation may differ: a similarity is fitted to the camera positions."""
    import numpy as np

    from koala3d.datasets.formats import load_scene
    from koala3d.datasets.process.world.comparison import compared

    found = compared(load_scene(scene, data_root=data_root), load_scene(reference, data_root=data_root))
    rows = {
        "position": (100 * found.positions, "%"),
        "direction": (found.turns_deg, " deg"),
        "fitted": (found.fitted_deg, " deg"),
    }
    result: dict[str, Any] = {"views": len(found.names)}
    cells = {}
    for name, (values, unit) in rows.items():
        middle, largest = float(np.median(values)), float(values.max())
        result[name] = {"median": middle, "largest": largest, "of": found.names[int(np.argmax(values))]}
        cells[name] = f"median {middle:.2f}{unit}, largest {largest:.2f}{unit} ({result[name]['of']})"
    text = f"{len(found.names)} views are in both scenes\n"
    text += f"position   {cells['position']} of the distance to where the cameras look\ndirection  {cells['direction']}; "
    text += f"if directions are fitted: {cells['fitted']}"
    console.report(result, as_json=as_json, text=text)


def _one_of(option: str, word: str, valid: tuple[str, ...]) -> None:
    """Raise UsageError where the value of an option is none of the valid ones."""
    from koala3d.datasets.core.errors import UsageError, nearest

    if word not in valid:
        raise UsageError(f"cannot be {word!r}", where=option, remedy=nearest(word, valid))


def wishes_of(marker_mm: float | None, known_length: tuple[str, str, float] | None, positions: Path | None, up: str) -> "Wishes":
    """What the options of one command say about size and up. Raises UsageError for a kind of up that there is not."""
    from koala3d.datasets.process.world import up as upward
    from koala3d.datasets.process.world.alignment import Wishes
    from koala3d.datasets.process.world.scale import KnownLength

    _one_of("--up", up, upward.KINDS)
    known = KnownLength.parse(*known_length) if known_length is not None else None
    return Wishes(None if marker_mm is None else marker_mm / 1000, known, positions, up)


def _facts(found: "Processed") -> dict[str, Any]:
    scene = found.aligned.scene
    return {
        "pictures": found.given,
        "placed": len(scene.views),
        "left_out": found.left_out,
        "groups": list(found.groups),
        "cameras": len({view.camera for view in scene.views}),
        "points": 0 if scene.points is None else len(scene.points),
        "error_px": found.error_px,
        "metric": scene.metric,
        "scale_from": found.aligned.scale_from,
        "up_from": found.aligned.up_from,
        "bounds_from": scene.bounds_from,
        "hint": found.aligned.hint,
        "resumed": found.resumed,
    }


def _text(found: "Processed") -> str:
    """The result for a person."""
    facts, scene = _facts(found), found.aligned.scene
    lenses = "one camera" if facts["cameras"] == 1 else f"{facts['cameras']} cameras"
    placed = f"{facts['placed']} of {found.given} pictures, {lenses}, {facts['points']} points"
    notes = [f"note    {note}" for note in scene.notes]
    return "\n".join([f"poses   {placed}, median error {found.error_px:.2f} px", *notes, *evidence(found.aligned)])


def evidence(found: "Aligned") -> list[str]:
    """Lines on unit and direction."""
    unit = found.scale_from or ("as before, metres" if found.scene.metric else "unknown: lengths are in units")
    return [f"scale   {unit}", f"up      {found.up_from or 'as it came'}", *([f"hint    {found.hint}"] if found.hint else [])]
