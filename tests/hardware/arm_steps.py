"""The steps with the arm: each moves one joint by two degrees at most, slowly, and returns."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.doctor.report import ask as ask_controller
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.safety import Limits
from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard
from koala3d.capture.drivers.ur.link import ChildLink, Deadlines
from koala3d.capture.drivers.ur.pendant import BUSY, client_for, connect
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.rtde.stream import RtdeStream
from koala3d.capture.drivers.ur.settling import NOISIEST_RAD, noise_of
from koala3d.capture.drivers.ur.stop_channel import STILL_RAD_S
from koala3d.capture.model.rig import RigDescription
from koala3d.datasets import pose
from tests.hardware.steps import Ask, Step, judged, skipped

STEP_RAD = float(np.radians(2.0))
SPEED, ACCELERATION = 0.05, 0.5  # [rad/s, rad/s^2]
CREEP = 0.02  # while a stop is waited for: two degrees take 1.8 s [rad/s]
RATE_HZ, NOISE_S = 125.0, 2.0
RETURN_M = 1e-4  # three times the repeatability of the data sheet
BRAKING_S = 0.3  # a watchdog's or a stop's own braking, from 0.02 rad/s
STOP_S = 1.0  # an order travels, is carried out, and the arm brakes
STOP_RAD = float(np.radians(0.5))
QUESTIONS = ("programState", "running", "get loaded program", "safetystatus", "robotmode")
OBSERVED = ["timestamp", "actual_q", "actual_qd", "runtime_state"]
PLAYING = 2


def robot_of(rig: RigDescription) -> UniversalRobot:
    """The arm of a rig, not connected."""
    robot = rig.robot
    limits = Limits.of(rig.arm, robot.max_joint_speed, robot.max_joint_acceleration)
    deadlines = Deadlines(stale_s=robot.stream_deadline_s, watchdog_hz=robot.watchdog_hz)
    return UniversalRobot(robot.host, limits=limits, deadlines=deadlines, client=robot.client, registers=robot.registers)


def gravity(rig: RigDescription, ask: Ask) -> Step:
    """The sign of the tool's accelerometer, and how level the base is."""
    name = "tool accelerometer"
    if not ask("Let the arm rest. The direction of gravity is measured; nothing moves."):
        return skipped(name, "by the operator")
    answers = ask_controller(rig.robot.host, 0.3)
    if answers.sample is None or answers.base_from_flange is None:
        return judged(name, False, "the controller does not say where its flange is")
    felt = answers.base_from_flange[:3, :3] @ np.array(answers.sample["actual_tool_accelerometer"])
    tilt = float(np.degrees(np.arccos(np.clip(felt[2] * rig.robot.installation.upwards / np.linalg.norm(felt), -1, 1))))
    words = "away from the ground" if tilt < 90 else "towards the ground: the opposite of what 'capture doctor' expects"
    found = f"{np.linalg.norm(felt):.2f} m/s^2, it points {words}, {min(tilt, 180 - tilt):.1f} degrees from the vertical"
    return judged(name, tilt < 5.0, found, acceleration=felt.tolist(), tilt_deg=tilt)


def noise(rig: RigDescription, ask: Ask) -> Step:
    """Noise of the encoders while the arm holds its position under our program."""
    name = "noise at rest"
    if not ask("The control program starts and holds the arm for two seconds; nothing moves."):
        return skipped(name, "by the operator")
    with robot_of(rig) as robot:
        joints = np.array(robot._connected().watched(NOISE_S, 100))
    spread, size = joints.std(axis=0), noise_of(joints)
    found = f"{1e6 * size:.1f} urad (standard deviation, noisiest joint) of {len(joints)} samples"
    return judged(name, size <= NOISIEST_RAD, found, noise_rad=size, each_rad=spread.tolist(), samples=len(joints))


def moves(rig: RigDescription, ask: Ask) -> list[Step]:
    """Each joint there and back, each after a question."""
    steps = []
    with robot_of(rig) as robot:
        start = robot.state()
        for joint in range(len(start.joints)):
            name = f"joint {joint + 1} by two degrees"
            goal = _aside(robot, start.joints, joint)
            if not ask(f"Joint {joint + 1} turns by two degrees at {np.degrees(SPEED):.0f} degrees/s, and back."):
                steps.append(skipped(name, "by the operator"))
                continue
            begun = time.monotonic()
            robot.move_to(goal, speed=SPEED, acceleration=ACCELERATION)
            there = float(np.abs(robot.state().joints - goal).max())
            robot.move_to(start.joints, speed=SPEED, acceleration=ACCELERATION)
            back = float(pose.difference(robot.state().base_from_flange, start.base_from_flange)[0])
            took = time.monotonic() - begun
            found = f"missed by {1e6 * there:.0f} urad, returned to {1e3 * back:.3f} mm, {took:.1f} s"
            steps.append(judged(name, back < RETURN_M, found, missed_rad=there, returned_m=back, seconds=took))
    return steps


def dashboard(rig: RigDescription, ask: Ask) -> Step:
    """What the pendant's interface says while our program runs: whether it knows of programs that are uploaded."""
    name = "replies while our program runs"
    if not ask("The control program starts and the dashboard is asked; nothing moves."):
        return skipped(name, "by the operator")
    with robot_of(rig):
        pendant = connect(rig.robot.host)
        state = pendant.program_state()
        replies = {one: pendant.ask(one) for one in QUESTIONS} if isinstance(pendant, Dashboard) else {}
        pendant.close()
    return judged(name, state.startswith(BUSY), f"{pendant.name}: {state}", **replies)


def stops(rig: RigDescription, ask: Ask) -> list[Step]:
    """Delay and distance from an order to stop until the arm rests: by the client, and by the dashboard without it."""
    pendant = connect(rig.robot.host)
    orders: dict[str, Callable[[UniversalRobot], object]] = {
        "stop by the client": lambda robot: robot.stop(),
        "stop by the pendant's interface": lambda robot: pendant.stop(),
    }
    steps = []
    for name, order in orders.items():
        if not ask(f"Joint 6 creeps at {np.degrees(CREEP):.1f} degrees/s and is stopped on its way: {name}."):
            steps.append(skipped(name, "by the operator"))
            continue
        with robot_of(rig) as robot:
            start = robot.state().joints
            seen = _interrupted(robot, start, lambda: order(robot), STOP_S)  # noqa: B023
        good = seen.distance_rad is not None and seen.distance_rad < STOP_RAD
        steps.append(judged(name, good, seen.words, **vars(seen)))
        _return(rig, start)
    pendant.close()
    return steps


def safeguard(rig: RigDescription, ask: Ask) -> Step:
    """A safeguard stop in the middle of a motion: named, and the arm does not go on when it is released."""
    name = "safeguard stop"
    if not ask("Joint 6 creeps for three seconds: open the fence, or cross the scanner, while it moves. Skip it without one."):
        return skipped(name, "by the operator")
    with robot_of(rig) as robot:
        start = robot.state().joints
        seen = _interrupted(robot, start, lambda: None, 5.0, speed=CREEP / 2)
    if not ask("Close the fence or reset the scanner now, and stand back."):
        return skipped(name, "not released")
    left = _joints(rig.robot.host)
    time.sleep(1.0)
    moved = float(np.abs(_joints(rig.robot.host) - left).max())
    good = "safety status" in seen.error and moved < STEP_RAD / 20
    found = f"{seen.error or 'nothing was reported'}; after the release it moved by {np.degrees(moved):.3f} degrees"
    step = judged(name, good, found, **vars(seen), moved_after_rad=moved)
    _return(rig, start)
    return step


def watchdog(rig: RigDescription, ask: Ask) -> Step:
    """How soon the controller ends the program and the arm rests when the client is killed, with nobody to stop it otherwise."""
    name = "watchdog"
    if not ask(f"Joint 6 creeps at {np.degrees(CREEP):.1f} degrees/s, and the client is killed on its way."):
        return skipped(name, "by the operator")
    robot = rig.robot
    pendant, period_s = connect(robot.host), 1 / robot.watchdog_hz
    with robot_of(rig) as whole:
        start, goal = whole.state().joints, _aside(whole, whole.state().joints, len(whole.state().joints) - 1)
    client = client_for(pendant, whole.client, robot.host)
    link = ChildLink.start(client, robot.host, 125.0, robot.watchdog_hz, robot.registers)
    observer = RtdeStream(robot.host, OBSERVED, [], RATE_HZ)
    try:
        if "ready" not in (link.wait_for(("ready", "failed"), 15.0) or {}):
            return judged(name, False, "the client did not start")
        link.request("move", joints=goal.tolist(), speed=CREEP, acceleration=ACCELERATION)
        _until(observer, lambda sample: np.abs(sample["actual_qd"]).max() > CREEP / 2, 2.0)
        link.process.kill()
        killed = time.monotonic()
        ended = _until(observer, lambda sample: sample["runtime_state"] != PLAYING, 5.0)
        ended_s = time.monotonic() - killed
        rested = _until(observer, lambda sample: np.abs(sample["actual_qd"]).max() < STILL_RAD_S / 2, 2.0)
        rest_s = time.monotonic() - killed
    finally:
        link.kill()
        observer.close()
        pendant.stop()
        pendant.close()
    good = ended is not None and rested is not None and ended_s < period_s + BRAKING_S
    found = (
        f"the program ended {1e3 * ended_s:.0f} ms after the kill, stated {1e3 * period_s:.0f} ms; at rest after {rest_s:.2f} s"
    )
    if ended is None:
        found = "the program still ran 5 s after the client was killed"
    step = judged(name, good, found, ended_s=ended_s, rest_s=rest_s, period_s=period_s)
    _return(rig, start)
    return step


@dataclass(frozen=True)
class Interrupted:
    """A motion that was interrupted: from the order until rest."""

    delay_s: float
    distance_rad: float | None  # None: it did not come to rest
    error: str

    @property
    def words(self) -> str:
        """For people."""
        if self.distance_rad is None:
            return "the arm did not come to rest"
        return f"at rest after {self.delay_s:.2f} s and {np.degrees(self.distance_rad):.3f} degrees"


def _interrupted(
    robot: UniversalRobot, start: NDArray[np.float64], order: Callable[[], object], within_s: float, speed: float = CREEP
) -> Interrupted:
    """Creep away with the last joint, give the order in the middle, and watch over a connection of its own."""
    goal, error = _aside(robot, start, len(start) - 1), []

    def move() -> None:
        try:
            robot.move_to(goal, speed=speed, acceleration=ACCELERATION)
        except CaptureError as caught:
            error.append(str(caught))

    observer = RtdeStream(robot.host, OBSERVED, [], RATE_HZ)
    mover = threading.Thread(target=move)
    mover.start()
    try:
        at = _until(observer, lambda sample: np.abs(np.subtract(sample["actual_q"], start)).max() > STEP_RAD / 8, 5.0)
        begun = time.monotonic()
        order()
        rest = _until(observer, lambda sample: np.abs(sample["actual_qd"]).max() < STILL_RAD_S / 2, within_s)
        delay = time.monotonic() - begun
    finally:
        observer.close()
        mover.join()
    if at is None or rest is None:
        return Interrupted(delay, None, "".join(error))
    return Interrupted(delay, float(np.abs(np.subtract(rest["actual_q"], at["actual_q"])).max()), "".join(error))


def _until(observer: RtdeStream, holds: Callable[[dict], object], patience_s: float) -> dict | None:
    """The first sample for which it holds; None: there was none in time."""
    deadline = time.monotonic() + patience_s
    while (left := deadline - time.monotonic()) > 0:
        sample = observer.newest(left)
        if sample is not None and holds(sample):
            return sample
    return None


def _aside(robot: UniversalRobot, joints: NDArray[np.float64], joint: int) -> NDArray[np.float64]:
    """The angles with one joint turned by two degrees, towards the middle of its range."""
    goal = joints.copy()
    goal[joint] -= STEP_RAD * np.sign(joints[joint] - (robot.limits.lower[joint] + robot.limits.upper[joint]) / 2 + 1e-9)
    return goal


def _joints(host: str) -> NDArray[np.float64]:
    observer = RtdeStream(host, OBSERVED, [], RATE_HZ)
    try:
        sample = observer.newest(1.0)
        return np.full(6, np.nan) if sample is None else np.array(sample["actual_q"])
    finally:
        observer.close()


def _return(rig: RigDescription, start: NDArray[np.float64]) -> None:
    """Go back to where a step began."""
    with robot_of(rig) as robot:
        robot.move_to(start, speed=SPEED, acceleration=ACCELERATION)
