"""The commands that start only the simulated controller of a rig, and that check its camera's driver."""

import time
from pathlib import Path
from typing import Annotated

from typer import Exit, Option

from koala3d.capture.cli.options import RigName, Settings, TrajectoryName
from koala3d.capture.drivers.errors import SimulationError
from koala3d.datasets.core import console


def sim(
    scene: Annotated[str, Option(help="Scene in front of the simulated camera, for the rig file.")] = "gold_head",
    out: Annotated[Path | None, Option(metavar="RIG.yaml", help="Write a rig file, for 'capture run --rig RIG.yaml'.")] = None,
    host: Annotated[str, Option(help="Loopback address to listen on.")] = "127.0.0.1",
    seed: Annotated[int, Option(min=0, help="Random seed.")] = 0,
    time_scale: Annotated[float, Option(min=0.1, max=1000, help="Speed of the arm relative to real time.")] = 1.0,
    rig: Annotated[str, Option(help="Whose arm: 'sim', or 'sim:' and the name or file of a rig.")] = "sim",
    hangs: Annotated[bool, Option("--hangs", help="Start as a hanging arm, for trajectories with 'up: -z'.")] = False,
    as_json: console.Json = False,
) -> None:
    """Start only the simulated controller of an arm, for any RTDE client. Prints its address and ports; Ctrl-C ends it."""
    from koala3d.capture.rig.controllers import controller_model, write_simulated_rig
    from koala3d.capture.rig.naming import describe
    from koala3d.capture.sim.controller.process import SimulatedController
    from koala3d.capture.sim.controller.server import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT
    from koala3d.capture.sim.laboratory.scenes import check_name

    scene = check_name(scene)
    description = describe(rig)
    model = controller_model(description)
    with SimulatedController.as_built(seed=seed, time_scale=time_scale, hangs=hangs, host=host, model=model) as controller:
        if out is not None:
            write_simulated_rig(out, controller, scene, seed, description)
        ports = {"rtde": RTDE_PORT, "script": SCRIPT_PORT, "dashboard": DASHBOARD_PORT, "side_channel": controller.side_port}
        hint = f"; rig file: {out}" if out is not None else ""
        listed = ", ".join(f"{name} {port}" for name, port in ports.items())
        text = f"{description.arm.name} at {controller.host}: {listed}{hint}. Ctrl-C ends it"
        console.report({"host": controller.host, "ports": ports, "scene": scene, "rig": out}, as_json=as_json, text=text)
        try:
            while controller.process.poll() is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            return
        raise SimulationError("the simulated controller has ended", why=controller.last_line(), remedy="start it again")


def check_camera(
    trajectory: TrajectoryName = Path("koala_demo"),
    rig: RigName = "sim",
    other_exposure_us: Annotated[
        float | None, Option("--other-exposure-us", help="Another exposure time to try [us]. Default: half of the trajectory's.")
    ] = None,
    settings: Settings = None,
    as_json: console.Json = False,
) -> None:
    """Check that the driver of a rig's camera keeps the contract of all drivers; some pictures are taken, the arm is not used.

    The camera takes the settings of the trajectory. The exit status is 1 where a clause is broken.
    """
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.rig.cameras import camera_for
    from koala3d.capture.rig.contract import CONTRACT, Subject, check
    from koala3d.capture.rig.naming import describe, is_simulated

    session, description = load_trajectory(trajectory, overrides=settings), describe(rig)
    scene = "grey_card" if is_simulated(rig, description) else ""
    exposure_us = other_exposure_us or session.camera.exposure_us / 2
    other = None if "exposure_us" in description.camera.leave else exposure_us
    subject = Subject(
        lambda wanted: camera_for(rig, session.model_copy(update={"camera": wanted}), scene=scene),
        session.camera,
        other_exposure_us=other,
    )
    broken = check(subject)
    lines = [f"{'broken' if name in broken else 'kept':6}  {name.replace('_', ' ')}" for name in CONTRACT]
    lines = [line if name not in broken else f"{line}: {broken[name]}" for name, line in zip(CONTRACT, lines, strict=True)]
    console.report(
        {"rig": rig, "kept": [name for name in CONTRACT if name not in broken], "broken": broken},
        as_json=as_json,
        text="\n".join(lines),
    )
    if broken:
        raise Exit(1)
