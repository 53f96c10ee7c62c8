"""The command `calib export`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.datasets.core.console import Json
from koala3d.datasets.core.errors import UsageError, nearest


def export(
    path: Annotated[Path, Argument(metavar="CALIBRATION", help="File made by 'calib handeye' or 'calib intrinsics'.")],
    to: Annotated[
        str,
        Option("--to", help="Format: opencv, ros, kalibr, easy_handeye2, urdf, xacro, moveit, tum or csv.", show_default=False),
    ],
    out: Annotated[Path, Option("--out", help="File to write.")],
    recording: Annotated[
        Path | None, Option("--recording", help="With tum and csv: the calibration's recording, if it was moved.")
    ] = None,
    json: Json = False,
) -> None:
    """Write a calibration as a file of another program.

    A comment in the file says which frames, axes and pixels it means.
    """
    from koala3d.calib.export.formats import FORMATS
    from koala3d.calib.export.source import Source
    from koala3d.datasets.calibration import Calibration
    from koala3d.datasets.core import files

    if to not in FORMATS:
        raise UsageError(f"no format called {to!r}", where="--to", remedy=nearest(to, FORMATS))
    if out.suffix not in (suffixes := FORMATS[to].suffixes):
        raise UsageError("has the wrong suffix", where=out, why=f"{to} ends with {' or '.join(suffixes)}", remedy="rename it")
    files.refuse_existing(out)
    source = Source(Calibration.load(path), path, out.stem, recording)
    files.write_text(out, FORMATS[to].write(source))
    console.report({"out": str(out), "format": to}, as_json=json, text=f"written to {out}")
