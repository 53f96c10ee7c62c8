"""What people's scripts call, through the vendor's own client over loopback. docs/simulated_controller.md lists the calls."""

import ast
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.capture.model.kinematics import forward, pose_from_six
from koala3d.capture.sim.controller.commands.table import ACTIONS, ANSWERS, CALLS
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets import pose
from tests.moments import until

WHEEL = "ur-rtde is not installed: it has no wheel for this Python and platform"
rtde_control, rtde_io, rtde_receive, dashboard_client = (
    pytest.importorskip(name, reason=WHEEL) for name in ("rtde_control", "rtde_io", "rtde_receive", "dashboard_client")
)
START = np.array([0.3, -1.4, 1.3, -1.5, -1.4, 0.2])
CLOSE = 1e-3
"""An angle of an arm at rest [rad]; the simulated encoders have no noise here."""
STRAIGHT_M = 1e-4
PAGE = Path(__file__).parents[4] / "docs" / "simulated_controller.md"


@dataclass
class Clients:
    """The client's four classes on one controller, whose clock runs four times as fast as the clock on the wall."""

    simulated: SimulatedController
    control: Any
    receive: Any
    io: Any
    dashboard: Any

    @property
    def joints(self) -> np.ndarray:
        return np.array(self.receive.getActualQ())

    @property
    def tool(self) -> np.ndarray:
        return np.array(self.receive.getActualTCPPose())

    @property
    def target(self) -> np.ndarray:
        """(3,) where the tool should be: without the oscillation after a stop [m]."""
        return np.array(self.receive.getTargetTCPPose())[:3]

    def arrived(self, joints: np.ndarray) -> bool:
        return bool(np.abs(self.joints - joints).max() < CLOSE)

    def at_rest(self) -> bool:
        return not self.simulated.ask("truth")["moving"] and bool(np.abs(self.receive.getActualQd()).max() < CLOSE)

    def start_again(self) -> None:
        """After the program has ended."""
        until(lambda: not self.control.isProgramRunning(), "the end of the program")
        if self.receive.isProtectiveStopped():
            self.dashboard.unlockProtectiveStop()
            until(lambda: not self.receive.isProtectiveStopped(), "an unlocked arm")
        self.control.isSteady()  # clears the command register: the next program would carry out what is in it
        self.control.reuploadScript()
        until(self.control.isProgramRunning, "a program that runs")


@pytest.fixture(scope="module")
def opened() -> Iterator[Clients]:
    with SimulatedController.start(seed=0, time_scale=4.0, repeatability_mm=0.0, repeatability_deg=0.0) as simulated:
        host, found = simulated.host, list[Any]()
        try:
            found.append(rtde_control.RTDEControlInterface(host))
            found.append(rtde_receive.RTDEReceiveInterface(host))
            found.append(rtde_io.RTDEIOInterface(host))
            found.append(dashboard_client.DashboardClient(host))
            found[-1].connect()
            yield Clients(simulated, *found)
        finally:
            for client in found:  # a client that loses its controller ends this process
                client.disconnect()


@pytest.fixture
def arm(opened: Clients) -> Clients:
    """The program runs, the arm stands still at `START`, and no tool is mounted."""
    opened.simulated.ask("install")
    if not opened.control.isProgramRunning() or opened.receive.isProtectiveStopped():
        opened.start_again()
    assert opened.control.setTcp([0.0] * 6) and opened.control.moveJ(START.tolist(), 3.0, 8.0)
    until(lambda: opened.arrived(START) and opened.at_rest(), "the arm at its start")
    return opened


def aside(arm: Clients, *way: float) -> np.ndarray:
    """The pose of the tool, moved in the base [m]."""
    return np.concatenate([arm.tool[:3] + way, arm.tool[3:]])


def watched(arm: Clients, call: Callable[[], object]) -> np.ndarray:
    """(k, 3) places where the tool should be during an asynchronous motion [m]; a blocking call would block this too."""
    places, begun = [arm.target], list[bool]()
    assert call()

    def ended() -> bool:
        places.append(arm.target)
        running = arm.control.getAsyncOperationProgressEx().isAsyncOperationRunning()
        begun.extend([True] * running)
        return bool(begun) and not running

    until(ended, "the end of the motion")
    return np.unique(np.array(places), axis=0)


def away_from_line(places: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(k,) distance of places from the line between two others [m]."""
    along = (end - start) / np.linalg.norm(end - start)
    between = places - start
    return np.linalg.norm(between - np.outer(between @ along, along), axis=-1)


@pytest.mark.parametrize("call", ["moveJ", "moveJ_IK", "moveL", "moveL_FK"])
def test_a_motion_ends_where_it_should(arm: Clients, call: str) -> None:
    goal = np.add(START, [0.2, -0.1, 0.15, -0.1, 0.1, 0.3])
    pose_there = forward(goal)
    six = [*pose_there[:3, 3], *pose.rotation_vector(pose_there)]
    wanted = goal.tolist() if call in ("moveJ", "moveL_FK") else six
    assert getattr(arm.control, call)(wanted, 1.0, 2.0)
    until(lambda: arm.arrived(goal) and arm.at_rest(), f"the end of {call}")
    until(lambda: np.allclose(pose_from_six(arm.tool), pose_there, rtol=0, atol=1e-4), "a state sent after that")
    np.testing.assert_allclose(pose_from_six(arm.tool), pose_there, atol=1e-4)


def test_a_line_of_the_tool_is_straight(arm: Clients) -> None:
    start, goal = arm.tool, aside(arm, 0.2, -0.15, -0.25)
    places = watched(arm, lambda: arm.control.moveL(goal.tolist(), 0.25, 1.2, True))
    middle = forward((START + np.array(arm.control.getInverseKinematics(goal.tolist()))) / 2)[:3, 3]
    assert away_from_line(middle[None], start[:3], goal[:3])[0] > 100 * STRAIGHT_M  # a line of the joints would not be
    assert len(places) > 10 and away_from_line(places, start[:3], goal[:3]).max() < STRAIGHT_M
    until(lambda: np.abs(arm.tool - goal).max() < STRAIGHT_M, "the end of the line")


def test_a_line_takes_the_tool_with_it_that_is_mounted(arm: Clients) -> None:
    assert arm.control.setTcp([0.02, 0.0, 0.15, 0.0, 0.4, 0.0])
    until(lambda: np.abs(arm.tool[:3] - forward(START)[:3, 3]).max() > 0.05, "the pose of the tool")
    there = pose_from_six(arm.tool) @ pose_from_six([0.0, 0.1, 0.05, 0.3, -0.2, 0.4])
    start, goal = arm.tool, np.array([*there[:3, 3], *pose.rotation_vector(there)])
    places = watched(arm, lambda: arm.control.moveL(goal.tolist(), 0.25, 1.2, True))
    assert away_from_line(places, start[:3], goal[:3]).max() < STRAIGHT_M
    until(lambda: np.abs(pose_from_six(arm.tool) - pose_from_six(goal)).max() < STRAIGHT_M, "the end of the line")


def corner_of(places: np.ndarray, points: np.ndarray) -> tuple[float, float]:
    """How near a path comes to the middle one of three points, and how far it is from their two lines elsewhere [m]."""
    near = np.linalg.norm(places - points[1], axis=-1)
    from_lines = np.minimum(*(away_from_line(places, points[at], points[at + 1]) for at in (0, 1)))
    return float(near.min()), float(from_lines[near > 0.03].max())


def test_a_path_of_lines_is_rounded_within_the_radius_and_straight_elsewhere(arm: Clients) -> None:
    points = np.array([arm.tool, aside(arm, 0.0, -0.15, 0.0), aside(arm, 0.1, -0.15, -0.1)])
    sharp = [[*point, 0.25, 1.2, 0.0] for point in points[1:]]
    places = watched(arm, lambda: arm.control.moveL(sharp, True))
    nearest, elsewhere = corner_of(places, points[:, :3])
    assert nearest < 6e-3 and elsewhere < STRAIGHT_M
    until(lambda: np.abs(arm.tool - points[2]).max() < STRAIGHT_M, "the end of the path")
    assert arm.control.moveJ(START.tolist(), 3.0, 8.0)
    until(lambda: arm.arrived(START) and arm.at_rest(), "the arm at its start")
    places = watched(arm, lambda: arm.control.moveL([[*points[1], 0.25, 1.2, 0.03], sharp[1]], True))
    nearest, elsewhere = corner_of(places, points[:, :3])
    assert 7e-3 < nearest < 0.03 and elsewhere < STRAIGHT_M


def test_a_path_of_joints_is_rounded_and_ends_at_its_last_waypoint(arm: Clients) -> None:
    corner, goal = np.add(START, [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]), np.add(START, [0.3, 0.2, 0.0, 0.0, 0.0, 0.0])
    places = watched(arm, lambda: arm.control.moveJ([[*corner, 1.0, 2.0, 0.05], [*goal, 0.8, 2.0, 0.0]], True))
    until(lambda: arm.arrived(goal) and arm.at_rest(), "the end of the path")
    nearest = np.linalg.norm(places - forward(corner)[:3, 3], axis=-1).min()
    assert 1e-3 < nearest < 0.05


def test_a_path_may_mix_motions_of_every_kind(arm: Clients) -> None:
    entry, path = rtde_control.PathEntry, rtde_control.Path()
    goal = np.add(START, [0.1, 0.1, -0.1, 0.0, 0.0, 0.2])
    down, back = aside(arm, 0.0, 0.0, -0.1), aside(arm, 0.05, 0.0, 0.0)
    path.addEntry(entry(entry.MoveJ, entry.PositionJoints, [*(START + 0.1), 1.0, 2.0, 0.02]))
    path.addEntry(entry(entry.MoveJ, entry.PositionTcpPose, [*back, 1.0, 2.0, 0.0]))
    path.addEntry(entry(entry.MoveL, entry.PositionTcpPose, [*down, 0.25, 1.2, 0.02]))
    path.addEntry(entry(entry.MoveP, entry.PositionTcpPose, [*back, 0.25, 1.2, 0.02]))
    path.addEntry(entry(entry.MoveL, entry.PositionJoints, [*goal, 0.25, 1.2, 0.0]))
    assert arm.control.movePath(path, True)
    seen = list[int]()

    def ended() -> bool:
        status = arm.control.getAsyncOperationProgressEx()
        if status.isAsyncOperationRunning() and status.progress() not in seen:
            seen.append(status.progress())
        return bool(seen) and not status.isAsyncOperationRunning()

    until(ended, "the end of the path")
    assert len(seen) > 1 and seen == sorted(seen) and seen[-1] == 4 and arm.control.getAsyncOperationProgress() < 0
    until(lambda: arm.arrived(goal) and arm.at_rest(), "the end of the path")


@pytest.mark.parametrize("stop", ["stopJ", "stopL"])
def test_an_asynchronous_line_is_stopped_on_its_way(arm: Clients, stop: str) -> None:
    start, goal = arm.tool, aside(arm, 0.25, -0.2, 0.1)
    assert arm.control.moveL(goal.tolist(), 0.25, 1.2, True)
    until(lambda: np.linalg.norm(arm.target - start[:3]) > 0.05, "a part of the way")
    getattr(arm.control, stop)(8.0)
    until(arm.at_rest, "rest")
    assert 0.05 < np.linalg.norm(arm.tool[:3] - start[:3]) < 0.25 and arm.control.getAsyncOperationProgress() < 0
    if stop == "stopL":
        assert away_from_line(arm.target[None], start[:3], goal[:3])[0] < STRAIGHT_M
    assert arm.control.moveJ(START.tolist(), 1.0, 2.0)
    until(arm.control.isSteady, "a steady arm")


def test_an_asynchronous_stop_comes_back_at_once(arm: Clients) -> None:
    assert arm.control.moveJ((START + 1.0).tolist(), 1.0, 2.0, True)
    until(lambda: np.abs(arm.receive.getActualQd()).max() > 0.5, "a part of the way")
    arm.control.stopJ(0.5, True)
    assert arm.simulated.ask("truth")["moving"]
    until(arm.at_rest, "rest")


@pytest.mark.parametrize("call", ["servoJ", "servoL"])
def test_a_stream_of_targets_is_followed(arm: Clients, call: str) -> None:
    goals = START + np.linspace(0, 1, 40)[:, None] * [0.1, -0.05, 0.1, 0.05, 0.0, 0.2]
    for goal in goals:
        there = forward(goal)
        wanted = goal.tolist() if call == "servoJ" else [*there[:3, 3], *pose.rotation_vector(there)]
        begin = arm.control.initPeriod()
        assert getattr(arm.control, call)(wanted, 0.0, 0.0, 0.002, 0.1, 300.0)
        arm.control.waitPeriod(begin)
    until(lambda: arm.arrived(goals[-1]), f"the last target of {call}")
    assert arm.control.servoStop(10.0) and arm.control.moveJ(START.tolist(), 1.0, 2.0)


def test_joints_keep_the_speeds_that_they_are_given(arm: Clients) -> None:
    wanted = np.array([0.1, 0.0, -0.05, 0.0, 0.2, 0.0])
    assert arm.control.speedJ(wanted.tolist(), 1.0)
    until(lambda: np.abs(np.array(arm.receive.getTargetQd()) - wanted).max() < 1e-9, "the speeds")
    np.testing.assert_allclose(arm.receive.getActualQd(), wanted, atol=1e-6)
    assert arm.control.speedStop(2.0)
    until(arm.at_rest, "rest")


@pytest.mark.parametrize("call", ["speedL", "jogStart"])
def test_the_tool_keeps_its_velocity_along_a_straight_line(arm: Clients, call: str) -> None:
    start, wanted = arm.target, np.array([0.02, -0.05, 0.03, 0.0, 0.0, 0.0])
    assert arm.control.speedL(wanted.tolist(), 0.5) if call == "speedL" else arm.control.jogStart(wanted.tolist(), acc=0.5)
    until(lambda: np.abs(np.array(arm.receive.getTargetTCPSpeed()) - wanted).max() < 1e-6, "the velocity")
    np.testing.assert_allclose(arm.receive.getActualTCPSpeed(), wanted, atol=1e-5)
    places = np.array([arm.target for _ in range(100) if not arm.control.waitPeriod(arm.control.initPeriod())])
    assert away_from_line(places, start, start + wanted[:3]).max() < STRAIGHT_M
    assert arm.control.speedStop(1.0) if call == "speedL" else arm.control.jogStop()
    until(arm.at_rest, "rest")
    assert away_from_line(arm.target[None], start, start + wanted[:3])[0] < STRAIGHT_M


def test_a_jog_in_the_axes_of_the_tool(arm: Clients) -> None:
    assert arm.control.jogStart([0.0, 0.0, 0.05, 0.0, 0.0, 0.0], rtde_control.RTDEControlInterface.FEATURE_TOOL)
    wanted = 0.05 * forward(START)[:3, 2]
    until(lambda: np.abs(np.array(arm.receive.getTargetTCPSpeed())[:3] - wanted).max() < 1e-6, "the velocity")
    assert arm.control.jogStop()


def test_moving_until_contact_goes_on_until_the_program_is_stopped(arm: Clients) -> None:
    start = arm.tool
    with ThreadPoolExecutor(1) as threads:
        blocked = threads.submit(arm.control.moveUntilContact, [0.0, 0.0, -0.05, 0.0, 0.0, 0.0])
        until(lambda: start[2] - arm.tool[2] > 0.03, "a way down")
        assert not blocked.done()
        arm.dashboard.stop()
        assert blocked.result(timeout=60) is False
    assert arm.control.isProgramRunning() is False


def test_kinematics_and_limits_are_those_of_the_arm(arm: Clients) -> None:
    here, six = forward(START), arm.tool.tolist()
    until(lambda: np.abs(pose_from_six(arm.control.getForwardKinematics()) - here).max() < 1e-5, "an arm that no longer swings")
    longer = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    other = np.add(START, 0.1)
    wanted = forward(other) @ pose_from_six(longer)
    np.testing.assert_allclose(pose_from_six(arm.control.getForwardKinematics(other.tolist(), longer)), wanted, atol=1e-6)
    np.testing.assert_allclose(arm.control.getInverseKinematics(six), START, atol=1e-3)
    other = np.add(START, [0.0, 0.0, 0.0, 0.0, 0.0, -2 * np.pi])
    np.testing.assert_allclose(arm.control.getInverseKinematics(six, other.tolist()), other, atol=1e-3)
    assert arm.control.getInverseKinematicsHasSolution(six)
    assert not arm.control.getInverseKinematicsHasSolution([2.0, *six[1:]])
    assert arm.control.isPoseWithinSafetyLimits(six) and arm.control.isJointsWithinSafetyLimits(START.tolist())
    arm.simulated.ask("joint_limit", joint=2, upper_deg=-70)
    beyond = forward([START[0], -1.0, *START[2:]])
    assert not arm.control.isPoseWithinSafetyLimits([*beyond[:3, 3], *pose.rotation_vector(beyond)])
    assert not arm.control.isJointsWithinSafetyLimits([*START[:1], -1.0, *START[2:]])
    arm.simulated.ask("joint_limit", joint=2)
    there = pose_from_six(arm.control.poseTrans(six, [0.0, 0.0, 0.1, 0.2, 0.0, 0.0]))
    np.testing.assert_allclose(there, pose_from_six(six) @ pose_from_six([0.0, 0.0, 0.1, 0.2, 0.0, 0.0]), atol=1e-9)
    np.testing.assert_allclose(pose_from_six(arm.control.getTargetWaypoint()), here, atol=1e-9)
    arm.control.getActualToolFlangePose()  # the client reads the answer before it is there: the second one is this call's
    until(lambda: np.abs(pose_from_six(arm.control.getActualToolFlangePose()) - here).max() < 1e-5, "the flange")
    until(lambda: arm.control.getStepTime() == 0.002, "the step time")
    assert arm.control.toolContact([0.0] * 6) == 0


def test_tool_and_payload_are_what_the_program_sets(arm: Clients) -> None:
    offset = [0.01, -0.02, 0.1, 0.0, 0.3, 0.0]
    assert arm.control.setTcp(offset)
    np.testing.assert_allclose(arm.control.getTCPOffset(), offset, atol=1e-12)
    until(lambda: np.abs(pose_from_six(arm.tool) - forward(START) @ pose_from_six(offset)).max() < 1e-5, "the tool's pose")
    assert arm.control.setPayload(1.5, [0.0, 0.01, 0.06])
    until(lambda: arm.receive.getPayload() == 1.5, "the payload")
    np.testing.assert_allclose(arm.receive.getPayloadCog(), [0.0, 0.01, 0.06])
    assert arm.control.setTargetPayload(2.0, [0.0, 0.0, 0.0], [0.1, 0.1, 0.1, 0.0, 0.0, 0.0])
    until(lambda: arm.receive.getPayload() == 2.0, "the payload")
    np.testing.assert_allclose(arm.receive.getPayloadCog(), [0.0, 0.01, 0.06])  # three zeros: the centre stays
    np.testing.assert_allclose(arm.receive.getPayloadInertia(), [0.1, 0.1, 0.1, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("begin", "end"), [("teachMode", "endTeachMode"), ("freedriveMode", "endFreedriveMode")])
def test_in_freedrive_the_arm_goes_where_a_hand_pushes_it(arm: Clients, begin: str, end: str) -> None:
    pushed = np.add(START, [0.2, 0.1, -0.1, 0.0, 0.1, 0.0])
    with pytest.raises(Exception, match="not in freedrive"):
        arm.simulated.push(pushed)
    assert getattr(arm.control, begin)() and arm.arrived(START)
    arm.simulated.push(pushed)
    until(lambda: arm.arrived(pushed) and arm.at_rest(), "the pushed arm")
    assert arm.control.getFreedriveStatus() == 0 and getattr(arm.control, end)()
    assert arm.arrived(pushed) and arm.control.moveJ(START.tolist(), 1.0, 2.0)


def test_freedrive_says_that_a_singularity_is_near(arm: Clients) -> None:
    assert arm.control.moveJ([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0], 3.0, 8.0)
    assert arm.control.freedriveMode() and arm.control.getFreedriveStatus() == 2 and arm.control.endFreedriveMode()


def test_the_button_of_the_pendant_works_without_a_program(arm: Clients) -> None:
    with pytest.raises(Exception, match="does nothing while a program runs"):
        arm.simulated.ask("freedrive")
    arm.control.stopScript()
    until(lambda: not arm.control.isProgramRunning(), "the end of the program")
    arm.simulated.ask("freedrive")
    arm.simulated.push(START + 0.1)
    until(lambda: arm.arrived(START + 0.1), "the pushed arm")
    assert arm.receive.getRobotStatus() >> 2 & 1
    arm.simulated.ask("freedrive", pressed=False)
    with pytest.raises(Exception, match="not in freedrive"):
        arm.simulated.push(START)


def test_outputs_are_read_back(arm: Clients) -> None:
    assert (
        arm.io.setStandardDigitalOut(3, True) and arm.io.setConfigurableDigitalOut(1, True) and arm.io.setToolDigitalOut(0, True)
    )
    until(lambda: all(arm.receive.getDigitalOutState(bit) for bit in (3, 9, 16)), "three outputs")
    assert arm.simulated.ask("signals")["digital"] == arm.receive.getActualDigitalOutputBits() == 1 << 3 | 1 << 9 | 1 << 16
    assert arm.io.setStandardDigitalOut(3, False)
    until(lambda: not arm.receive.getDigitalOutState(3), "an output that is off again")
    assert arm.receive.getDigitalOutState(9) and arm.receive.getDigitalOutState(16)
    assert arm.io.setAnalogOutputVoltage(0, 0.25) and arm.io.setAnalogOutputCurrent(1, 0.5)
    until(lambda: arm.receive.getStandardAnalogOutput0() == 2.5, "a quarter of 10 V")
    until(lambda: arm.receive.getStandardAnalogOutput1() == 0.012, "half of 4 to 20 mA")
    assert arm.simulated.ask("signals")["volts"] == [True, False] and arm.io.setSpeedSlider(1.0)


def test_the_watchdog_stops_the_program_that_nobody_kicks(arm: Clients) -> None:
    assert arm.control.setWatchdog(2.0) and arm.control.kickWatchdog()
    until(lambda: not arm.control.isProgramRunning(), "the watchdog")


@pytest.mark.parametrize(
    ("begin", "then", "why"),
    [
        ("", "moveL far", r"moveL \(command 3\): the tool's path leads out of reach or through a singularity"),
        ("", "moveJ_IK far", r"moveJ_IK \(command 2\): the inverse kinematics of a pose has no solution"),
        ("speedJ", "moveJ", r"moveJ \(command 1\): another thread already moves the arm: speedJ goes on"),
        ("speedJ", "stopL", r"stopL \(command 33\): another thread already moves the arm"),
        ("servoJ", "speedL", r"speedL \(command 10\): another thread already moves the arm: servoJ goes on"),
        ("moveJ", "speedL", r"speedL \(command 10\): another thread already moves the arm: an asynchronous motion"),
        ("teachMode", "moveJ", r"moveJ \(command 1\): the arm is in freedrive"),
        ("", "moveJ path beyond", r"movePath \(command 45\): waypoint 2 of the path: joint 6 at 401 degrees, limit 360"),
        ("", "moveJ beyond", r"protective stop: a motion was ordered with joint 6 at 401 degrees, limit 360"),
        ("", "speedL through", r"protective stop: the tool's path leads out of reach, through a singularity"),
        ("", "forceMode", r"forceMode \(command 6\) is not simulated"),
    ],
)
def test_what_cannot_be_done_ends_the_program_and_is_said(arm: Clients, begin: str, then: str, why: str) -> None:
    control, joints, up = arm.control, START.tolist(), [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    calls: dict[str, Callable[[], object]] = {
        "": lambda: True,
        "speedJ": lambda: control.speedJ([0.1] * 6),
        "servoJ": lambda: control.servoJ(joints, 0.0, 0.0, 0.002, 0.1, 300.0),
        "speedL": lambda: control.speedL([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]),
        "moveJ": lambda: control.moveJ([*joints[:5], 2.0], 0.5, 1.0, begin == "moveJ"),
        "teachMode": control.teachMode,
        "moveL far": lambda: control.moveL(aside(arm, -1.0, 0.0, 0.0).tolist()),
        "moveJ_IK far": lambda: control.moveJ_IK(aside(arm, -1.0, 0.0, 0.0).tolist()),
        "stopL": lambda: control.stopL(5.0),
        "moveJ path beyond": lambda: control.moveJ([[*joints, 1.0, 1.0, 0.0], [*joints[:5], 7.0, 1.0, 1.0, 0.0]]),
        "moveJ beyond": lambda: control.moveJ([*joints[:5], 7.0]),
        "speedL through": lambda: control.speedL(up, 5.0),
        "forceMode": lambda: control.forceMode([0.0] * 6, [0] * 6, [0.0] * 6, 2, [0.1] * 6),
    }
    assert calls[begin]()
    answer = calls[then]()
    until(lambda: re.search(why, arm.simulated.last_line()), why)
    assert then.split()[0] in ("speedL", "forceMode", "stopL") or answer is False  # the client does not wait for these
    until(lambda: not control.isProgramRunning(), "the end of the program")


def test_a_protective_stop_that_a_client_asks_for(arm: Clients) -> None:
    assert arm.control.triggerProtectiveStop() is False  # it worked, and the program that would say so has ended
    until(arm.receive.isProtectiveStopped, "the stop")


def documented() -> set[str]:
    """Calls in the first column of the table on the page."""
    table = PAGE.read_text().split("## Calls")[1].split("## ")[0]
    return {
        call for line in table.splitlines() if line.startswith("| `") for call in re.findall(r"`(\w+)`", line.split(" | ")[0])
    }


def called_here() -> set[str]:
    """Names of the attributes that this file uses, and of the calls that it names in parameters."""
    nodes = list(ast.walk(ast.parse(Path(__file__).read_text())))
    names = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    return names | {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def test_every_call_on_the_page_exists_and_is_tested() -> None:
    classes = (rtde_control.RTDEControlInterface, rtde_receive.RTDEReceiveInterface, rtde_io.RTDEIOInterface)
    known = {name for one in classes for name in dir(one)}
    assert len(documented()) > 60 and documented() <= known
    assert not documented() - called_here()


def test_every_command_that_is_simulated_is_on_the_page() -> None:
    simulated = {CALLS[number] for number in (*ACTIONS, *ANSWERS)}
    assert not simulated - documented() and not {CALLS[number] for number in CALLS.keys() - {*ACTIONS, *ANSWERS}} & documented()
