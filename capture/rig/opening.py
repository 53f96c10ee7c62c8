"""Opens a rig: the real one that a file describes, or the simulated one of a seed."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from capture.rig.description import RigDescription, load_rig
from capture.rig.protocols import Camera, Robot
from capture.trajectory import Trajectory
from datasets.core.errors import UsageError

if TYPE_CHECKING:
    from capture.sim.controller.handle import ControllerHandle

SIMULATED = "sim"


class Witness(Protocol):
    """Knows the truth behind each picture: only a simulation has one."""

    def prepare(self, frame: int) -> None:
        """Say which frame comes next."""

    def keep_truth(self, folder: Path, name: str, split: str) -> None:
        """Write what is true of the newest picture."""


@dataclass(frozen=True)
class Rig:
    """An arm and its camera, both connected."""

    robot: Robot
    camera: Camera
    description: RigDescription
    name: str
    """"sim", or the path of the rig file."""
    witness: Witness | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    """What a recording keeps beyond that: of a simulation its scene and seed."""

    @property
    def flange_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) nominal mount [m]."""
        return self.description.flange_from_camera.matrix()


def describe(name: str) -> RigDescription:
    """The description of a rig by name; raises UsageError where its file is missing or wrong."""
    if name != SIMULATED and not Path(name).exists():
        raise UsageError(
            "no such file", where=name, remedy=f"--rig takes {SIMULATED} or the file of a rig, as configs/rigs/ur5e_basler.yaml"
        )
    return RigDescription() if name == SIMULATED else load_rig(name)


@contextmanager
def open_rig(name: str, trajectory: Trajectory, *, scene: str, seed: int, time_scale: float) -> Iterator[Rig]:
    """Connect arm and camera, and close both again.

    Args:
        name: "sim", or the path of a rig file.
        trajectory: camera settings and motion.
        scene: what stands in front of the simulated camera.
        seed: of everything random in the simulation that is started here; one that runs already has its own.
        time_scale: how much faster than real time the simulated arm is, where it is started here.
    """
    description = describe(name)
    with _controller(name, description, trajectory, seed, time_scale) as controller:
        if controller is None:
            from capture.cameras.basler import Basler

            with Basler(trajectory.camera, serial=description.camera.serial) as camera:
                with _arm(description, trajectory, None) as robot:
                    yield Rig(robot, camera, description, name)
            return
        from capture.sim.camera import SimulatedCamera
        from capture.sim.truth import RigTruth

        seed = seed if description.simulation is None else description.simulation.seed
        truth = RigTruth.draw(description.flange_from_camera.matrix(), seed)
        with SimulatedCamera(trajectory, scene, truth, controller, seed) as simulated:
            with _arm(description, trajectory, controller) as robot:
                yield Rig(robot, simulated, description, name, simulated, {"scene": scene, "seed": seed})


@contextmanager
def open_arm(
    name: str, trajectory: Trajectory, *, seed: int, links_seed: int, time_scale: float
) -> Iterator[tuple[Robot, "ControllerHandle | None"]]:
    """Connect the arm alone; the second is the simulated controller, None for a real arm.

    Arguments as of `open_rig`; an arm that is started here has the links of `links_seed` and stops with the errors of `seed`.
    """
    description = describe(name)
    with _controller(name, description, trajectory, seed, time_scale, links_seed) as controller:
        with _arm(description, trajectory, controller) as robot:
            yield robot, controller


@contextmanager
def _controller(
    name: str, description: RigDescription, trajectory: Trajectory, seed: int, time_scale: float, links_seed: int | None = None
) -> "Iterator[ControllerHandle | None]":
    """The simulated controller of a rig, started here or found running; None for a real one."""
    if name == SIMULATED:
        from capture.sim.controller.process import SimulatedController

        hangs = trajectory.upwards < 0
        with SimulatedController.as_built(seed=seed, time_scale=time_scale, links_seed=links_seed, hangs=hangs) as started:
            yield started
    elif description.simulation is not None:
        from capture.sim.controller.handle import ControllerHandle

        with closing(ControllerHandle(description.robot.host, description.simulation.side_port)) as running:
            yield running
    else:
        yield None


def _arm(description: RigDescription, trajectory: Trajectory, controller: "ControllerHandle | None") -> Robot:
    from capture.robots.timing import Deadlines, Settling
    from capture.robots.ur import UR5e
    from capture.safety import Limits

    motion, robot = trajectory.motion, description.robot
    limits = Limits(speed=robot.max_joint_speed, acceleration=robot.max_joint_acceleration)
    settling = Settling(motion.settle_speed, motion.settle_time_s, motion.settle_timeout_s)
    if controller is None:
        return UR5e(robot.host, limits=limits, settling=settling)
    patient = Deadlines(stale_s=2.0, watchdog_hz=0.5)  # rendering takes all of the computer
    return UR5e(controller.host, limits=limits, settling=settling, deadlines=patient, frequency=125.0)


def write_simulated_rig(path: Path, controller: "ControllerHandle", scene: str, seed: int) -> None:
    """A rig file for a simulated controller that runs already; raises UsageError where the file exists."""
    import yaml

    from datasets.core import files

    files.refuse_existing(path)
    content = {
        "robot": {"host": controller.host},
        "simulation": {"side_port": controller.side_port, "scene": scene, "seed": seed},
    }
    files.write_text(path, yaml.safe_dump(content, sort_keys=False))


def scene_for(rig: str, scene: str, trajectory: Trajectory) -> str:
    """The simulated scene for a trajectory: the one named, else the one that suits it; "" for a real rig.

    Raises:
        UsageError: no such scene (naming the nearest), one that the trajectory does not suit, or a real rig is asked for one.
    """
    simulation = None if rig == SIMULATED else describe(rig).simulation
    if rig != SIMULATED and simulation is None:
        if scene:
            raise UsageError("--scene belongs to the simulation", where=rig, remedy="leave it out, or use --rig sim")
        return ""
    from capture.sim.laboratory.views import check_scene

    if not scene:
        scene = "charuco_board" if trajectory.target is not None else "gold_head" if simulation is None else simulation.scene
    check_scene(scene, trajectory)
    return scene
