"""Opens a rig: a real one that a file describes, or a simulated one that a seed defines."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from koala3d import configs
from koala3d.capture.drivers.errors import naming
from koala3d.capture.drivers.protocols import Camera, GroundTruth, Robot, Turntable
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription, load_rig
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.turntable import required
from koala3d.capture.rig.turntable import open_turntable, simulated_turntable
from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    from koala3d.capture.model.flaws import Flaws
    from koala3d.capture.sim.controller.handle import ControllerHandle
    from koala3d.capture.sim.kinematic_arm import KinematicArm
    from koala3d.capture.sim.turntable import SimulatedTurntable

    Simulation = ControllerHandle | KinematicArm  # both know where the flange truly is

SIMULATED = "sim"  # name of the simulated rig; "sim:NAME" is the simulation of another rig
Examination = Callable[[RigDescription, str, bool], None]
"""Gets the rig, the address of its controller, and whether it is simulated."""


@dataclass(frozen=True)
class Rig:
    """An arm and its camera, both connected; with several cameras the rig as the first one has it."""

    robot: Robot
    camera: Camera
    description: RigDescription
    name: str  # "sim", "sim:NAME", or the name or path of the rig file
    ground_truth: GroundTruth | None = None  # only in a simulation
    extra: dict[str, Any] = field(default_factory=dict)  # more entries for the manifest: the scene and seed of a simulation
    turntable: Turntable | None = None  # connected where the trajectory turns the object
    cameras: "dict[str, Rig]" = field(default_factory=dict)  # the rig as each camera has it, by name; empty: there is one camera

    @property
    def each(self) -> "dict[str, Rig]":
        """The rig as each of its cameras has it, by the camera's name; one camera has the empty name."""
        return self.cameras or {"": self}

    @property
    def carrier(self) -> Carrier:
        """The arm with its camera and what stands around it."""
        return self.description.carrier()

    @property
    def flange_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) nominal mount [m]; without meaning where the camera stands beside the arm."""
        return self.description.flange_from_camera.matrix()


def describe(name: str) -> RigDescription:
    """The description of a rig: "sim", a shipped rig by name, or a rig file, the last two also after "sim:".

    Raises UsageError where it is missing or wrong.
    """
    if name == SIMULATED:
        return RigDescription()
    if name.startswith(f"{SIMULATED}:"):
        found = describe(name.removeprefix(f"{SIMULATED}:"))
        alone = None if found.simulation is None else found.simulation.model_copy(update={"side_port": None})
        return found.model_copy(update={"simulation": alone})
    path = configs.find("rigs", name, others=(SIMULATED,))
    if not path.exists():
        remedy = f"--rig takes {SIMULATED}, a name that 'capture list' shows, or a rig file"
        raise UsageError("no such file", where=name, remedy=remedy)
    return load_rig(path)


def is_simulated(name: str, description: RigDescription) -> bool:
    """Whether a rig is a simulated one."""
    return is_started(name, description) or description.simulation is not None


def is_started(name: str, description: RigDescription) -> bool:
    """Whether the rig is a simulated one whose controller is started by the command."""
    if name == SIMULATED or name.startswith(f"{SIMULATED}:"):
        return True
    return description.simulation is not None and description.simulation.side_port is None


def flaws_of(description: RigDescription) -> "Flaws":
    """Flaws of a rig's simulated camera; none where the description has no simulation."""
    from koala3d.capture.model.flaws import Flaws

    return Flaws() if description.simulation is None else description.simulation.flaws


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


@contextmanager
def open_rig(
    name: str,
    trajectory: Trajectory,
    *,
    scene: str,
    seed: int,
    time_scale: float,
    examine: Examination = lambda description, host, simulated: None,
    take_over: bool = False,
    radiometry: Path | None = None,
) -> Iterator[Rig]:
    """Connect cameras, arm and turntable, in this order; leaving the context closes all.

    Args:
        name: "sim", "sim:NAME", or the name or path of a rig file.
        scene: what the simulated camera looks at.
        seed: of everything random in a simulation that is started here. A running simulation has its own seed.
        time_scale: speed of a simulated arm that is started here, relative to real time.
        examine: called before anything is connected; may refuse by raising.
        take_over: end a program that runs on the controller; else the arm is left to it.
        radiometry: measured response of the camera, in place of the one that the rig file names.

    Raises UsageError: `radiometry` for several cameras, or views that turn a turntable which the rig lacks. KoalaError names
    the camera that could not be opened.
    """
    description = describe(name)
    if radiometry is not None:
        if description.cameras:
            remedy = "leave --radiometry out, and write 'radiometry' below each camera in the rig file"
            raise UsageError("one response for several cameras", where=radiometry, remedy=remedy)
        camera = description.camera.model_copy(update={"radiometry": str(radiometry)})
        description = description.model_copy(update={"camera": camera})
    table = required(description.turntable, trajectory.name) if trajectory.turns else None
    hangs = trajectory.upwards < 0
    with controller_of(name, description, hangs=hangs, seed=seed, time_scale=time_scale) as controller:
        examine(description, host_of(description, controller), controller is not None)
        simulation = description.simulation
        running = simulation is not None and simulation.side_port is not None
        seed = simulation.seed if simulation is not None and running else seed
        with ExitStack() as stack:
            simulated = None if controller is None else table
            turned = stack.enter_context(simulated_turntable(simulated, seed=seed, time_scale=time_scale))
            opened = {}
            for number, (camera_name, one) in enumerate(description.each.items()):
                with naming(camera_name):
                    camera, truth = _camera(one, trajectory, controller, scene, seed, turned, number)
                    opened[camera_name] = stack.enter_context(camera), one, truth
            robot = stack.enter_context(_arm(description, trajectory, controller, take_over))
            driven = table if turned is None else turned.reached
            turntable = stack.enter_context(open_turntable(driven))  # last, since it may turn to find its zero
            extra = {} if controller is None else {"scene": scene, "seed": seed}
            rigs = {
                camera_name: Rig(robot, camera, one, name, truth, extra, turntable)
                for camera_name, (camera, one, truth) in opened.items()
            }
            first = next(iter(rigs.values()))
            yield replace(first, cameras=rigs) if description.cameras else first


def _camera(
    rig: RigDescription,
    trajectory: Trajectory,
    controller: "Simulation | None",
    scene: str,
    seed: int,
    turned: "SimulatedTurntable | None",
    number: int,
) -> tuple[Camera, GroundTruth | None]:
    """The camera of a rig, not connected, and what knows the truth about it; `number` as in `SimulatedCamera`."""
    if controller is None:
        from koala3d.capture.rig.cameras import camera_of

        return camera_of(rig.camera, trajectory.camera), None
    from koala3d.capture.sim.camera import SimulatedCamera
    from koala3d.capture.sim.truth import RigTruth, seed_of_camera

    truth, flaws = RigTruth.of(rig.carrier(), trajectory, seed_of_camera(seed, number)), flaws_of(rig)
    made = SimulatedCamera(trajectory, scene, truth, controller, seed, flaws, device=rig.camera, table=turned, number=number)
    return made, made


def camera_for(name: str, trajectory: Trajectory, *, scene: str, seed: int = 0, view: int = 0) -> Camera:
    """The camera of a rig, not connected; entering it connects it and leaves the arm alone.

    Args:
        scene: what a simulated camera looks at.
        seed: of everything random in a simulation.
        view: number of the view of the trajectory from which a simulated camera looks.
    """
    description = describe(name)
    if not is_simulated(name, description):
        from koala3d.capture.rig.cameras import camera_of

        return camera_of(description.camera, trajectory.camera)
    from koala3d.capture.planning import Obstacles
    from koala3d.capture.sim.camera import SimulatedCamera, StillArm
    from koala3d.capture.sim.truth import RigTruth

    carrier = description.carrier()
    arm = StillArm(Obstacles.of(trajectory, carrier).flange_for(trajectory.viewpoints()[view].camera_pose(carrier)))
    truth, flaws = RigTruth.of(carrier, trajectory, seed), flaws_of(description)
    return SimulatedCamera(trajectory, scene, truth, arm, seed, flaws, device=description.camera)


@contextmanager
def open_camera(name: str, trajectory: Trajectory, *, scene: str, seed: int = 0, view: int = 0) -> Iterator[Camera]:
    """Connect only the camera; arguments as in `camera_for`."""
    with camera_for(name, trajectory, scene=scene, seed=seed, view=view) as camera:
        yield camera


@contextmanager
def open_arm(
    name: str, trajectory: Trajectory, *, seed: int, links_seed: int, time_scale: float
) -> Iterator[tuple[Robot, "Simulation | None"]]:
    """Connect only the arm. The second value is the simulated controller, or None for a real arm.

    Arguments as in `open_rig`. A simulated arm that is started here has the links of `links_seed` and the positioning errors
    of `seed`.
    """
    description = describe(name)
    hangs = trajectory.upwards < 0
    with controller_of(name, description, hangs=hangs, seed=seed, time_scale=time_scale, links_seed=links_seed) as controller:
        with _arm(description, trajectory, controller) as robot:
            yield robot, controller


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

        with SimulatedController.as_built(**options, model=description.robot.model) as started:
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


def _arm(description: RigDescription, trajectory: Trajectory, controller: "Simulation | None", take_over: bool = False) -> Robot:
    from koala3d.capture.drivers.safety import Limits
    from koala3d.capture.drivers.ur.robot import UniversalRobot
    from koala3d.capture.drivers.ur.settling import Settling
    from koala3d.capture.drivers.ur.timing import Deadlines
    from koala3d.capture.sim.kinematic_arm import KinematicArm

    motion, robot, arm = trajectory.motion, description.robot, description.arm
    limits = Limits.of(arm, robot.max_joint_speed, robot.max_joint_acceleration)
    settling = Settling(motion.settle_spread, motion.settle_time_s, motion.settle_timeout_s)
    if isinstance(controller, KinematicArm):
        controller.limits, controller.settling = limits, settling
        return controller
    if arm.family != "ur":
        remedy = "'--rig sim:NAME' simulates it; only arms of Universal Robots are driven"
        raise UsageError(f"Koala has no driver for the {arm.name}", where="robot.model", remedy=remedy)
    if controller is None:
        return UniversalRobot(robot.host, limits=limits, settling=settling, client=robot.client, take_over=take_over)
    patient = Deadlines(stale_s=2.0, watchdog_hz=0.5)  # rendering uses every core
    options: dict[str, Any] = {"limits": limits, "settling": settling, "client": robot.client, "take_over": take_over}
    return UniversalRobot(controller.host, deadlines=patient, frequency=125.0, **options)


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
    own = {"host": controller.host, **rig.robot.model_dump(mode="json", include={"model"}, exclude_defaults=True)}
    kept = {"camera", "flange_from_camera", "cameras", "beside", "obstacles", "turntable", "lights"}
    rest = rig.model_dump(mode="json", include=kept, exclude_defaults=True)
    content = {"robot": own, **rest, "simulation": simulation}
    files.write_text(path, yaml.safe_dump(content, sort_keys=False))


def scene_for(rig: str, scene: str, trajectory: Trajectory) -> str:
    """The simulated scene for a trajectory: the named one, or else one that fits the trajectory; "" for a real rig.

    Raises UsageError: there is no such scene, the trajectory does not fit it, or the rig is real.
    """
    description = describe(rig)
    simulation = description.simulation
    if not is_simulated(rig, description):
        if scene:
            raise UsageError("--scene is only for simulated rigs", where=rig, remedy="leave it out, or use --rig sim")
        return ""
    from koala3d.capture.sim.laboratory.views import check_scene

    if not scene:
        scene = "board" if trajectory.target is not None else "gold_head" if simulation is None else simulation.scene
    return check_scene(scene, trajectory)
