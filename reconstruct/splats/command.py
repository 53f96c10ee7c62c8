"""The command that makes splats of a trained run."""

from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import RunFolder
from koala3d.reconstruct.output.commands import StandsOn


def splats(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE", help="File to write: FILE.ply, .spz, .glb or .usd; must be new.")],
    count: Annotated[int, Option("--count", min=100, max=10_000_000, help="Largest number of splats.")] = 100_000,
    stands_on: StandsOn = None,
    as_json: console.Json = False,
) -> None:
    """Write the surface as Gaussian splats with colours for each direction, for splat viewers."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.output.commands import opened
    from koala3d.reconstruct.splats import splats as made_of
    from koala3d.reconstruct.splats.writing import saving

    save = saving.writer(out)
    refuse_existing(out)
    found = made_of.make(opened(run), count=count, stands_on=stands_on)
    save(found, out)
    result, text = saving.summary(found)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")
