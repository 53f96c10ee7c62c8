"""Opens the arm of a rig."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.rig.controllers import controller_of, device_lock, host_of
from koala3d.capture.rig.naming import describe
from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    from koala3d.capture.rig.controllers import Simulation

Examination = Callable[[RigDescription, str, bool], Mapping[str, str]]
"""Gets the rig, the address of its controller, and whether it is simulated; returns what is wrong and ignored."""


def unexamined(rig: RigDescription, host: str, simulated: bool) -> Mapping[str, str]:
    """The examination that finds nothing."""
    return {}


def arm_of(
    description: RigDescription, trajectory: Trajectory, controller: "Simulation | None", take_over: bool = False
) -> Robot:
    """The arm of a rig, not connected; `controller` is its simulation."""
    from koala3d.capture.drivers.safety import Limits
    from koala3d.capture.drivers.ur.link import Deadlines
    from koala3d.capture.drivers.ur.robot import UniversalRobot
    from koala3d.capture.drivers.ur.settling import Settling
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
    options: dict[str, Any] = {"limits": limits, "settling": settling, "take_over": take_over}
    options |= {"client": robot.client, "registers": robot.registers}
    options["deadlines"] = Deadlines(stale_s=robot.stream_deadline_s, watchdog_hz=robot.watchdog_hz)
    if controller is None:
        return UniversalRobot(robot.host, **options)
    return UniversalRobot(controller.host, frequency=125.0, **options)


def require_payload(description: RigDescription, name: str, controller: "Simulation | None") -> None:
    """Raise UsageError if a real arm is to move and its rig file does not state what it carries.

    The controller's own value is compared with it before each session, since any program may have left another one there.
    """
    if controller is None and description.arm.family == "ur" and description.robot.installation.payload_kg is None:
        why = "with a wrong payload the arm stops for safety, and sags"
        remedy = "weigh camera, lens, bracket and plug, or read what 'capture doctor' finds at the pendant, and enter it in kg"
        raise UsageError("robot.installation.payload_kg is not stated", where=name, why=why, remedy=remedy)


@contextmanager
def open_arm(
    name: str,
    trajectory: Trajectory,
    *,
    seed: int,
    links_seed: int,
    time_scale: float,
    examine: Examination = unexamined,
    take_over: bool = False,
) -> Iterator[tuple[Robot, "Simulation | None"]]:
    """Connect only the arm. The second value is the simulated controller, or None for a real arm.

    Arguments as in `open_rig`. A simulated arm that is started here has the links of `links_seed` and the positioning errors
    of `seed`.
    """
    description = describe(name)
    hangs = trajectory.upwards < 0
    with controller_of(name, description, hangs=hangs, seed=seed, time_scale=time_scale, links_seed=links_seed) as controller:
        require_payload(description, name, controller)
        examine(description, host_of(description, controller), controller is not None)
        with (
            device_lock(f"arm-{description.robot.host}", "arm", controller),
            arm_of(description, trajectory, controller, take_over) as robot,
        ):
            yield robot, controller
