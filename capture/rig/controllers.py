"""The simulated controller of a rig: started here, or running already and described by a rig file."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koala3d.capture.model.flaws import Flaws
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.rig.naming import is_started
from koala3d.datasets.core import locks
from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    from koala3d.capture.sim.controller.handle import ControllerHandle
    from koala3d.capture.sim.kinematic_arm import KinematicArm

    Simulation = ControllerHandle | KinematicArm  # both know where the flange truly is


@contextmanager
def controller_of(
    name: str,
    description: RigDescription,
    *,
    hangs: bool = False,
    seed: int = 0,
    time_scale: float = 1.0,
    links_seed: int | None = None,
) -> "Iterator[Simulation | None]":
    """The simulated controller of a rig, started here or already running; None for a real rig.

    An arm of another maker than Universal Robots is simulated without a controller.
    """
    options: dict[str, Any] = {"seed": seed, "time_scale": time_scale, "links_seed": links_seed, "hangs": hangs}
    started_here = is_started(name, description)
    side_port = None if description.simulation is None else description.simulation.side_port
    if started_here and description.arm.family == "ur":
        from koala3d.capture.sim.controller.process import SimulatedController

        flaws = Flaws() if description.simulation is None else description.simulation.flaws
        noise_rad, model = flaws.encoder_noise_rad, description.robot.model
        with SimulatedController.as_built(**options, model=model, noise_rad=noise_rad) as started:
            if flaws.drift_mm:
                started.ask("warm_up", drift_mm=flaws.drift_mm, minutes=flaws.drift_minutes)
            yield started
    elif started_here:
        from koala3d.capture.sim.kinematic_arm import KinematicArm

        yield KinematicArm(description.arm, **options)
    elif side_port is not None:
        from koala3d.capture.sim.controller.handle import ControllerHandle

        with closing(ControllerHandle(description.robot.host, side_port)) as running:
            yield running
    else:
        yield None


def device_lock(name: str, what: str, controller: "Simulation | None") -> AbstractContextManager[None]:
    """The lock of a real device, which one process uses at a time; a simulated one has none."""
    return locks.device(name, what) if controller is None else nullcontext()


def controller_model(description: RigDescription) -> str:
    """The model of the arm for a simulated controller; raises UsageError where no such controller drives it."""
    if description.arm.family != "ur":
        what = f"the {description.arm.name} has no simulated controller"
        raise UsageError(what, remedy="'capture run --rig sim:NAME' moves it without one")
    return description.robot.model


def host_of(description: RigDescription, simulation: "Simulation | None") -> str:
    """The address of the arm's controller; for an arm that is simulated without one, its name."""
    if simulation is None:
        return description.robot.host
    return getattr(simulation, "host", description.arm.name)


def write_simulated_rig(
    path: Path, controller: "ControllerHandle", scene: str, seed: int, rig: RigDescription | None = None
) -> None:
    """Write the rig file of a running simulated controller; raises UsageError where the file exists.

    Args:
        rig: the rig that is simulated; None: the default one.
    """
    import yaml

    from koala3d.datasets.core import files

    files.refuse_existing(path)
    simulation = {"side_port": controller.side_port, "scene": scene, "seed": seed}
    rig = rig or RigDescription()
    own = {
        "host": controller.host,
        **rig.robot.model_dump(mode="json", include={"model", "cable", "max_tool_speed"}, exclude_defaults=True),
    }
    kept = {"camera", "flange_from_camera", "cameras", "beside", "obstacles", "turntable", "lights", "lamps"}
    rest = rig.model_dump(mode="json", include=kept, exclude_defaults=True)
    content = {"robot": own, **rest, "simulation": simulation}
    files.write_text(path, yaml.safe_dump(content, sort_keys=False))
