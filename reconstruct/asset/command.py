"""The command that makes an asset of a trained run."""

from pathlib import Path
from typing import Annotated, Any

from typer import Option, Typer

from datasets.core import console
from reconstruct.options import RunFolder
from reconstruct.output.commands import StandsOn

app = Typer()


def _format(name: str | None) -> str | None:
    """A format of robot simulators, or none."""
    from datasets.core.errors import UsageError, nearest
    from reconstruct.asset.robot.saving import WRITERS

    if name is not None and name not in WRITERS:
        raise UsageError(f"there is no robot format '{name}'", where="--robot", remedy=nearest(name, WRITERS))
    return name


_FILE = "File to write: FILE.glb, .obj, .usd or .usdz; with --robot a folder; must be new."
_ROBOT = "Write a folder for robot simulators: urdf or mjcf, with convex parts, mass and inertia."


@app.command()
def asset(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE|FOLDER", help=_FILE)],
    faces: Annotated[int, Option(min=100, help="Target number of triangles.")] = 20_000,
    texture: Annotated[int, Option(min=64, max=8192, help="Width and height of the textures in texels.")] = 1024,
    resolution: Annotated[int, Option(min=16, max=768, help="Grid points along the longest side of the object's box.")] = 256,
    stands_on: StandsOn = None,
    closed: Annotated[bool, Option("--closed/--open", help="Close the surface where it leaves the box.")] = True,
    robot: Annotated[str | None, Option("--robot", metavar="urdf|mjcf", callback=_format, help=_ROBOT)] = None,
    mass: Annotated[float | None, Option(min=1e-6, max=1e6, help="With --robot: mass of the object in kg.")] = None,
    density: Annotated[float | None, Option(min=1e-3, max=1e6, help="With --robot: density of the object in kg/m3.")] = None,
    parts: Annotated[int, Option(min=1, max=1024, help="With --robot: largest number of convex parts.")] = 32,
    as_json: console.Json = False,
) -> None:
    """Bake a run into a textured mesh that renderers, viewers, modelling programs and robot simulators show."""
    from datasets.core.errors import UsageError
    from datasets.core.files import refuse_existing
    from reconstruct.asset import asset as assets
    from reconstruct.asset.robot import body as bodies
    from reconstruct.asset.robot import saving as bodies_saving
    from reconstruct.asset.robot.mass import Weight
    from reconstruct.asset.writing import saving
    from reconstruct.output.commands import opened

    shape: dict[str, Any] = {"faces": faces, "size": texture, "resolution": resolution, "stands_on": stands_on}
    if robot is None:
        if mass is not None or density is not None:
            raise UsageError("--mass and --density are for --robot", remedy="add --robot urdf or --robot mjcf")
        save = saving.writer(out)
        refuse_existing(out)
        made, _ = assets.make(opened(run), **shape, closed=closed)
        save(made, out)
        result, text = saving.summary(made)
    else:
        weight = Weight(density, mass)
        if not closed:
            raise UsageError("--open is not for --robot", why="an open surface has no mass", remedy="leave --open out")
        refuse_existing(out)
        body = bodies.make(opened(run), weight, **shape, parts=parts)
        bodies_saving.save(body, out, robot)
        result, text = bodies_saving.summary(body)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")
