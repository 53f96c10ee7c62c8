"""The command `reconstruct bench asset`."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import RunFolder
from koala3d.reconstruct.output.commands import Split


def asset_command(
    run: RunFolder,
    asset: Annotated[Path, Argument(metavar="ASSET.glb", help="Asset of the run, written by 'reconstruct asset'.")],
    light: Annotated[Path, Argument(metavar="LIGHT.exr", help="Light around it, written by 'reconstruct light'.")],
    split: Split = "test",
    paths: Annotated[
        int, Option(min=1, max=65536, help="Light paths per pixel; more of them take longer and are less noisy.")
    ] = 64,
    out: Annotated[
        Path | None, Option("--out", help="New folder for a picture of each view: photograph, model, asset side by side.")
    ] = None,
    relit: Annotated[
        int | None,
        Option(min=0, metavar="NUMBER", help="Also show it in another studio's light (scenes of 'bench scenes' only)."),
    ] = None,
    as_json: console.Json = False,
) -> None:
    """Render a run's asset with Mitsuba under its light, compare with the photographs, add the figures to RUN/metrics.json."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.bench.asset import proof
    from koala3d.reconstruct.output.commands import opened

    if out is not None:
        refuse_existing(out)
    found = proof.prove(opened(run), asset, light, split=split, paths=paths, relit=relit, out=out)
    places = "\n".join(str(path) for path in (run / proof.METRICS, out) if path is not None)
    console.report(found, as_json=as_json, text=f"{proof.text(found)}\n{places}")
