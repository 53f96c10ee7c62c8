"""Opens a rig: a real one that a file describes, or a simulated one that a seed defines."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from koala3d.capture.drivers.errors import naming
from koala3d.capture.drivers.protocols import Turntable
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.turntable import TurntableDescription, required
from koala3d.capture.rig.arms import Examination, arm_of, require_payload, unexamined
from koala3d.capture.rig.cameras import camera_in
from koala3d.capture.rig.controllers import controller_of, device_lock, host_of
from koala3d.capture.rig.lamps import SwitchedLamps
from koala3d.capture.rig.links import reported_links
from koala3d.capture.rig.moves import Moves
from koala3d.capture.rig.naming import describe
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.incidents import IGNORED
from koala3d.datasets.recording import POSE, UPRIGHT

if TYPE_CHECKING:
    from koala3d.capture.rig.controllers import Simulation
    from koala3d.capture.sim.turntable import SimulatedTurntable


@contextmanager
def open_rig(
    name: str,
    trajectory: Trajectory,
    *,
    scene: str,
    seed: int,
    time_scale: float,
    examine: Examination = unexamined,
    take_over: bool = False,
    radiometry: Path | None = None,
    moves: Moves | None = None,
    pose: str = UPRIGHT,
) -> Iterator[Rig]:
    """Connect cameras, arm and turntable, in this order; leaving the context closes all.

    Args:
        name: "sim", "sim:NAME", or the name or path of a rig file.
        scene: what the simulated camera looks at.
        seed: of everything random in a simulation that is started here. A running simulation has its own seed.
        time_scale: speed of a simulated arm that is started here, relative to real time.
        examine: called before anything is connected; may refuse by raising. What it ignores is for the manifest.
        take_over: end a program that runs on the controller; else the arm is left to it.
        radiometry: measured response of the camera, in place of the one that the rig file names.
        moves: how the arm moves; None: with the speeds of the trajectory.
        pose: name of the way in which the object lies, for the manifest; in a simulation it lies so.

    Raises UsageError: `radiometry` for several cameras, views that need a turntable or lamps which the rig lacks, or a real arm
    whose payload nobody states. KoalaError names the camera that could not be opened.
    """
    description = _with_response(describe(name), radiometry)
    table = required(description.turntable, trajectory.name) if trajectory.turns else None
    hangs = trajectory.upwards < 0
    description.require_lamps(trajectory.switched, trajectory.name)
    with controller_of(name, description, hangs=hangs, seed=seed, time_scale=time_scale) as controller:
        require_payload(description, name, controller)
        ignored = dict(examine(description, host := host_of(description, controller), controller is not None))
        simulation = description.simulation
        running = simulation is not None and simulation.side_port is not None
        seed = simulation.seed if simulation is not None and running else seed
        with ExitStack() as stack:
            simulated = None if controller is None else table
            turned = stack.enter_context(_simulated_turntable(simulated, seed=seed, time_scale=time_scale))
            opened = {}
            for number, (camera_name, one) in enumerate(description.each.items()):
                with naming(camera_name):
                    stack.enter_context(_camera_lock(one, controller))
                    camera, truth = camera_in(one, trajectory, controller, scene, seed, turned, number, pose)
                    opened[camera_name] = stack.enter_context(camera), one, truth
            stack.enter_context(device_lock(f"arm-{description.robot.host}", "arm", controller))
            robot = stack.enter_context(arm_of(description, trajectory, controller, take_over))
            links, moves = reported_links(description, host), moves or Moves()
            lamps = stack.enter_context(_lamps(description, controller) if trajectory.switches else nullcontext())
            driven = table if turned is None else turned.reached
            turntable = stack.enter_context(_turntable(driven))  # last, since it may turn to find its zero
            extra: dict[str, Any] = {POSE: pose} | ({} if controller is None else {"scene": scene, "seed": seed})
            extra |= {IGNORED: ignored} if ignored else {}
            parts: dict[str, Any] = {"extra": extra, "turntable": turntable, "links": links, "moves": moves, "lamps": lamps}
            rigs = {key: Rig(robot, camera, one, name, truth, **parts) for key, (camera, one, truth) in opened.items()}
            first = next(iter(rigs.values()))
            yield replace(first, cameras=rigs) if description.cameras else first


def _with_response(description: RigDescription, radiometry: Path | None) -> RigDescription:
    """The rig with a measured response of its camera; None: with its own. Raises UsageError: it has several cameras."""
    if radiometry is None:
        return description
    if description.cameras:
        remedy = "leave --radiometry out, and write 'radiometry' below each camera in the rig file"
        raise UsageError("one response for several cameras", where=radiometry, remedy=remedy)
    camera = description.camera.model_copy(update={"radiometry": str(radiometry)})
    return description.model_copy(update={"camera": camera})


def _camera_lock(one: RigDescription, controller: "Simulation | None") -> AbstractContextManager[None]:
    return device_lock(f"camera-{one.camera.model}-{one.camera.serial}", "camera", controller)


def _lamps(description: RigDescription, controller: "Simulation | None") -> SwitchedLamps:
    """The switched lamps, not connected. Raises UsageError: the arm has no controller with digital outputs."""
    host = host_of(description, controller)
    if description.arm.family != "ur":
        remedy = "leave 'lamps' out of the trajectory, or switch them by hand and state 'lights'"
        raise UsageError(f"no controller of the {description.arm.name} switches lamps", where="lamps", remedy=remedy)
    return SwitchedLamps(host, {name: lamp.output for name, lamp in description.lamps.items()})


def _turntable(table: TurntableDescription | None) -> AbstractContextManager[Turntable | None]:
    """The driver, not connected; entering it connects, and turns the table if it looks for its switch."""
    if table is None:
        return nullcontext()
    from koala3d.capture.drivers.turntable.grbl import GrblTurntable

    return GrblTurntable(table)


def _simulated_turntable(
    table: TurntableDescription | None, *, seed: int, time_scale: float
) -> AbstractContextManager["SimulatedTurntable | None"]:
    """A simulated controller with the object on its table, not started; arguments as in `SimulatedTurntable`."""
    if table is None:
        return nullcontext()
    from koala3d.capture.sim.turntable import SimulatedTurntable

    return SimulatedTurntable(table, seed, time_scale)
