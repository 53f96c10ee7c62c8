"""The command `calib board`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    from koala3d.datasets.targets.board import Board


def board_named(path: Path) -> "Board":
    """A target by its shipped name or its file. Raises UsageError or TargetError where there is none, or it cannot be printed."""
    from koala3d import configs
    from koala3d.calib.targets.detection import check_markers
    from koala3d.datasets.targets.board import load_board

    return check_markers(load_board(configs.find("boards", path)), where=path)


def board(
    out: Annotated[Path, Option("--out", help="File to write: .pdf or .svg.")],
    shipped: Annotated[
        Path | None,
        Option("--board", help="Target to print: a name from 'capture list', or a file. The options below then have no effect."),
    ] = None,
    kind: Annotated[
        str, Option("--kind", help="charuco, chessboard, tags, aprilgrid, circles or asymmetric_circles.")
    ] = "charuco",
    squares: Annotated[str, Option("--squares", help="Squares along x and y.")] = "9x7",
    square_mm: Annotated[float, Option("--square-mm", help="Side of a square [mm].")] = 30.0,
    marker_mm: Annotated[
        float | None, Option("--marker-mm", help="Side of a marker, diameter of a circle [mm]. Default: 73 % of a square.")
    ] = None,
    dictionary: Annotated[
        str, Option("--dictionary", help="Marker dictionary, by its name in OpenCV. Default: DICT_5X5_100; Kalibr's.")
    ] = "",
    first_id: Annotated[int, Option("--first-id", help="Number of the first tag.")] = 0,
    as_json: console.Json = False,
) -> None:
    """Make a target to print, in true size."""
    from koala3d.calib.targets import printing
    from koala3d.calib.targets.detection import read_board

    if shipped is not None:
        target = board_named(shipped)
    else:
        numbers = squares.lower().split("x")
        if len(numbers) != 2 or not all(n.isdigit() for n in numbers):
            raise UsageError("is not a number of squares such as 9x7", where="--squares", why=f"{squares!r} given")
        marker = 0.0 if kind == "chessboard" else round(0.73 * square_mm, 1) if marker_mm is None else marker_mm
        sizes = {"square_length_m": 1e-3 * square_mm, "marker_length_m": 1e-3 * marker, "first_id": first_id}
        named = {"dictionary": dictionary or None, **sizes}
        target = read_board({"type": kind, "squares_x": int(numbers[0]), "squares_y": int(numbers[1]), **named}, where="board")
    printing.write(target, out)
    width, height = printing.page_mm(target)
    text = f"page of {width:.0f} x {height:.0f} mm; print it without scaling, then measure the bar of 100 mm\nwritten to {out}"
    console.report({"out": str(out), "page_mm": [width, height], "board": target.to_json()}, as_json=as_json, text=text)
