"""The command `flat`: measures the response of the camera."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from koala3d.capture.cli.options import RigName, Seed, Settings, TrajectoryName
from koala3d.datasets.core import console


def flat(
    trajectory: TrajectoryName,
    out: Annotated[Path, Option(metavar="FLAT.npz", help="New file to write.")],
    rig: RigName = "sim",
    frames: Annotated[int, Option(min=2, max=1000, help="Pictures of the card, and of darkness.")] = 32,
    seed: Seed = 0,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Measure black level, flat field, hot pixels, white balance and noise of the camera. The arm is not used.

    The camera takes the settings of the trajectory. Cover the lens, then hold an evenly lit grey card in front of it."""
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.rig.cameras import camera_for
    from koala3d.capture.rig.naming import describe, is_simulated
    from koala3d.capture.sessions.live.flat import measured, statistics, words
    from koala3d.datasets.core.files import refuse_existing

    refuse_existing(out)
    session = load_trajectory(trajectory, overrides=settings)
    ask = not is_simulated(rig, describe(rig))
    series = {"lens_cap": "cover the lens", "grey_card": "fill the picture with an evenly lit grey card, out of focus"}
    found, said = [], {}
    for scene, request in series.items():
        if ask:
            typer.confirm(f"{request}; ready?", default=True, abort=True, err=True)
        with console.progress(request, frames, "pictures") as shown:
            with camera_for(rig, session, scene=scene, seed=seed, flat=out) as camera:
                found.append(statistics(camera, frames, shown.advance))
                said = camera.description()
    result = measured(said, *found)
    result.save(out)
    content = {"out": out, "black": result.black, "balance": result.balance, "hot": len(result.hot)}
    content |= {"read": result.read, "shot": result.shot, "serial": result.serial, "pixel_format": result.pixel_format}
    console.report(content, as_json=as_json, text=words(result, out))
