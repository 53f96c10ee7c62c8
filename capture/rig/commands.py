"""The command that starts only the simulated controller of a rig."""

import time
from pathlib import Path
from typing import Annotated

from typer import Option

from capture.errors import SimulationError
from datasets.core import console


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
    from capture.rig.opening import controller_model, describe, write_simulated_rig
    from capture.sim.controller.process import SimulatedController
    from capture.sim.controller.server import DASHBOARD_PORT, RTDE_PORT, SCRIPT_PORT
    from capture.sim.laboratory.scenes import check_name

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
