"""The commands that make an asset of a trained run, and a picture of the light around it."""

from pathlib import Path
from typing import Annotated, Any

from typer import Option

from koala3d.datasets.core import console
from koala3d.reconstruct.options import RunFolder
from koala3d.reconstruct.output.commands import StandsOn

Faces = Annotated[int, Option(min=100, help="Target number of triangles.")]
Resolution = Annotated[int, Option(min=16, max=768, help="Grid points along the longest side of the object's box.")]
Closed = Annotated[bool, Option("--closed/--open", help="Close the surface where it leaves the box.")]


def _format(name: str | None) -> str | None:
    """A format of robot simulators, or none."""
    from koala3d.datasets.core.errors import UsageError, nearest
    from koala3d.reconstruct.asset.robot.saving import WRITERS

    if name is not None and name not in WRITERS:
        raise UsageError(f"there is no robot format '{name}'", where="--robot", remedy=nearest(name, WRITERS))
    return name


_FILE = "File to write: FILE.glb, .obj, .usd or .usdz; with --robot a folder; must be new."
_ROBOT = "Write a folder for robot simulators: urdf or mjcf, with convex parts, mass and inertia."


def asset(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE|FOLDER", help=_FILE)],
    light: Annotated[
        Path | None, Option("--light", metavar="FILE.exr", help="Also write the light, as 'reconstruct light' does; must be new.")
    ] = None,
    faces: Faces = 20_000,
    texture: Annotated[int, Option(min=64, max=8192, help="Width and height of the textures in texels.")] = 1024,
    resolution: Resolution = 256,
    stands_on: StandsOn = None,
    closed: Closed = True,
    robot: Annotated[str | None, Option("--robot", metavar="urdf|mjcf", callback=_format, help=_ROBOT)] = None,
    mass: Annotated[float | None, Option(min=1e-6, max=1e6, help="With --robot: mass of the object in kg.")] = None,
    density: Annotated[float | None, Option(min=1e-3, max=1e6, help="With --robot: density of the object in kg/m3.")] = None,
    parts: Annotated[int, Option(min=1, max=1024, help="With --robot: largest number of convex parts.")] = 32,
    as_json: console.Json = False,
) -> None:
    """Bake a run into a textured mesh that renderers, viewers, modelling programs and robot simulators show."""
    from koala3d.datasets.core.errors import UsageError
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.asset import asset as assets
    from koala3d.reconstruct.asset.writing import environment, saving
    from koala3d.reconstruct.output.commands import opened

    shape: dict[str, Any] = {"faces": faces, "size": texture, "resolution": resolution, "stands_on": stands_on}
    if robot is not None:
        if light is not None or not closed:
            why = "a body for simulators is closed and brings no light"
            raise UsageError("--light and --open are not for --robot", why=why, remedy="leave them out")
        _write_body(run, out, robot, (density, mass), parts, shape, as_json)
        return
    if mass is not None or density is not None:
        raise UsageError("--mass and --density are for --robot", remedy="add --robot urdf or --robot mjcf")
    save = saving.writer(out)
    refuse_existing(out)
    if light is not None:
        refuse_existing(environment.check(light))
    trained = opened(run)
    if light is not None:
        environment.refuse_moving(trained)
    made, around = assets.make(trained, **shape, closed=closed)
    save(made, out)
    if light is not None:
        environment.save(around, made.base_from_asset, light)
    result, text = saving.summary(made)
    files = [str(path) for path in (out, light) if path is not None]
    console.report({"out": str(out), **result}, as_json=as_json, text="\n".join([text, *files]))


def _write_body(
    run: Path,
    out: Path,
    robot: str,
    weight: tuple[float | None, float | None],
    parts: int,
    shape: dict[str, Any],
    as_json: bool,
) -> None:
    """Write the folder of a body for robot simulators."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.asset.robot import body as bodies
    from koala3d.reconstruct.asset.robot import saving
    from koala3d.reconstruct.asset.robot.mass import Weight
    from koala3d.reconstruct.output.commands import opened

    wanted = Weight(*weight)
    refuse_existing(out)
    body = bodies.make(opened(run), wanted, **shape, parts=parts)
    saving.save(body, out, robot)
    result, text = saving.summary(body)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")


def light(
    run: RunFolder,
    out: Annotated[Path, Option("--out", metavar="FILE.exr", help="File to write; must be new.")],
    height: Annotated[int, Option(min=16, max=4096, help="Rows of the picture; it has twice as many columns.")] = 256,
    faces: Faces = 20_000,
    resolution: Resolution = 256,
    stands_on: StandsOn = None,
    closed: Closed = True,
    as_json: console.Json = False,
) -> None:
    """Write the light around the object, as its surface mirrors it, as an equirectangular HDR picture."""
    from koala3d.datasets.core.files import refuse_existing
    from koala3d.reconstruct.asset import asset as assets
    from koala3d.reconstruct.asset.writing import environment
    from koala3d.reconstruct.output.commands import opened
    from koala3d.reconstruct.output.mesh import extraction

    refuse_existing(environment.check(out))
    trained = opened(run)
    environment.refuse_moving(trained)
    surface = extraction.extract(trained, faces=faces, resolution=resolution, stands_on=stands_on, watertight=closed)
    found = assets.light_around(trained, surface)
    environment.save(found, assets.base_from_asset(surface.vertices, stands_on), out, height=height)
    result, text = environment.summary(found)
    console.report({"out": str(out), **result}, as_json=as_json, text=f"{text}\n{out}")
