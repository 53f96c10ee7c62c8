"""The command `sim`: a simulated controller that runs by itself."""

import time
from pathlib import Path
from typing import Annotated

from typer import Option

from koala3d.capture.drivers.errors import SimulationError
from koala3d.datasets.core import console


def sim(
    scene: Annotated[str, Option(help="Scene in front of the simulated camera, for the rig file.")] = "gold_head",
    out: Annotated[Path | None, Option(metavar="RIG.yaml", help="Write a rig file, for 'capture run --rig RIG.yaml'.")] = None,
    host: Annotated[str, Option(help="Loopback address to listen on.")] = "127.0.0.1",
    seed: Annotated[int, Option(min=0, help="Random seed.")] = 0,
    time_scale: Annotated[float, Option(min=0.1, max=1000, help="Speed of the arm relative to real time.")] = 1.0,
    rig: Annotated[str, Option(help="The rig whose arm is simulated: 'sim', or 'sim:RIG' for a rig by name or file.")] = "sim",
    hangs: Annotated[bool, Option("--hangs", help="Start as a hanging arm, for trajectories with 'up: -z'.")] = False,
    as_json: console.Json = False,
) -> None:
    """Start only the simulated controller of an arm, for any RTDE client. Prints its address and ports; Ctrl-C ends it.

    What the simulation does not know is refused with one line here that names it.
    """
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
                for line in controller.new_lines():
                    console.hint(line)
                time.sleep(0.2)
        except KeyboardInterrupt:
            return
        raise SimulationError("the simulated controller has ended", why=controller.last_line(), remedy="start it again")
