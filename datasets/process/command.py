"""The command `datasets process`; `datasets.cli` registers it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from datasets.core import console
from datasets.core.options import Json, OutFolder

if TYPE_CHECKING:
    from datasets.process.process import Processed

POINT = "PICTURE:X,Y+PICTURE:X,Y"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(process)


def process(
    source: Annotated[Path, typer.Argument(metavar="PHOTOS|VIDEO", help="Folder of photographs, or a video.")],
    out: OutFolder,
    frames: Annotated[int, typer.Option(metavar="N", min=3, help="Most frames to take from a video.")] = 100,
    match: Annotated[
        str,
        typer.Option(help="Pairs to match: all, neighbours (in order of names), alike, or auto, which depends on their number."),
    ] = "auto",
    vocabulary: Annotated[
        Path | None, typer.Option(metavar="FILE", help="COLMAP's vocabulary tree, to choose the pairs.")
    ] = None,
    cameras: Annotated[
        str, typer.Option(help="Pictures that share a lens: auto (size, maker, model and focal length), size, or each.")
    ] = "auto",
    marker_mm: Annotated[
        float | None, typer.Option(metavar="MM", help="Printed side of the ArUco, AprilTag or ChArUco markers in view.")
    ] = None,
    known_length: Annotated[
        tuple[str, str, float] | None,
        typer.Option(metavar="A B METRES", help=f"A known distance between two points A and B, each written {POINT}."),
    ] = None,
    positions: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Lines NAME X Y Z: where camera or flange were, in metres.")
    ] = None,
    up: Annotated[
        str, typer.Option(help="What tells the z axis: marker, plane, cameras, none; auto tries them in this order.")
    ] = "auto",
    as_json: Json = False,
) -> None:
    """Make a posed scene from photographs or a video.

    If it is interrupted, the same command continues where it stopped."""
    from datasets.core.errors import UsageError, nearest
    from datasets.process.pictures import photographs
    from datasets.process.poses import pairs
    from datasets.process.process import Request
    from datasets.process.process import process as process_pictures
    from datasets.process.world import up as upward
    from datasets.process.world.alignment import Wishes
    from datasets.process.world.scale import KnownLength

    for option, word, valid in (
        ("--match", match, pairs.KINDS), ("--cameras", cameras, photographs.SHARING), ("--up", up, upward.KINDS),
    ):  # fmt: skip
        if word not in valid:
            raise UsageError(f"cannot be {word!r}", where=option, remedy=nearest(word, valid))
    known = KnownLength.parse(*known_length) if known_length is not None else None
    wishes = Wishes(None if marker_mm is None else marker_mm / 1000, known, positions, up)
    found = process_pictures(source, out, Request(frames, match, vocabulary, cameras), wishes)
    console.report({"scene": str(out), **_facts(found)}, as_json=as_json, text=f"{_text(found)}\nwritten to {out}")


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
    lines = [
        f"poses   {facts['placed']} of {found.given} pictures, {lenses}, {facts['points']} points, "
        f"median error {found.error_px:.2f} px",
        f"scale   {found.aligned.scale_from or 'unknown: lengths are in units'}",
        f"up      {found.aligned.up_from or 'as it came'}",
        *(f"note    {note}" for note in scene.notes),
    ]
    return "\n".join([*lines, *([f"hint    {found.aligned.hint}"] if found.aligned.hint else [])])
