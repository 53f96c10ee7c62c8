"""The command that makes an asset of a trained run."""

from pathlib import Path
from typing import Annotated

from typer import Option, Typer

from datasets.core import console
from reconstruct.options import RunFolder
from reconstruct.output.commands import StandsOn

app = Typer()


@app.command()
def asset(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE", help="File to write: FILE.glb, .obj, .usd or .usdz; must be new.")],
    faces: Annotated[int, Option(min=100, help="Target number of triangles.")] = 20_000,
    texture: Annotated[int, Option(min=64, max=8192, help="Width and height of the textures in texels.")] = 1024,
    resolution: Annotated[int, Option(min=16, max=768, help="Grid points along the longest side of the object's box.")] = 256,
    stands_on: StandsOn = None,
    closed: Annotated[bool, Option("--closed/--open", help="Close the surface where it leaves the box.")] = True,
    as_json: console.Json = False,
) -> None:
    """Bake a run into a textured mesh that renderers, viewers and modelling programs show."""
    from datasets.core.files import refuse_existing
    from reconstruct.asset import asset as assets
    from reconstruct.asset.writing import saving
    from reconstruct.output.commands import opened

    save = saving.writer(out)
    refuse_existing(out)
    made, _ = assets.make(opened(run), faces=faces, size=texture, resolution=resolution, stands_on=stands_on, closed=closed)
    save(made, out)
    result, text = saving.summary(made)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")
