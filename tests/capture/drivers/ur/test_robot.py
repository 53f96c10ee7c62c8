"""The driver with either client over loopback, with and without faults."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from koala3d.capture.drivers.errors import (
    CaptureError,
    MotionError,
    NotReady,
    ProtectiveStop,
    RigConnectionError,
    SafetyError,
    StopLatched,
)
from koala3d.capture.drivers.ur.client import versioned
from koala3d.capture.drivers.ur.koala_client import KoalaClient
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.settling import Settling
from koala3d.capture.model.kinematics import forward
from koala3d.capture.sim.controller.motions.arm import QUIET_S
from koala3d.capture.sim.controller.process import ENCODER_NOISE_RAD, SimulatedController
from koala3d.datasets import pose
from tests.capture.moving import FAR, UNHURRIED, in_motion, moves, rests, stopped_on_its_way
from tests.moments import until

pytestmark = pytest.mark.client("koala")
VENDORS = pytest.mark.client("ur_rtde")
"""For what the vendor's client could do differently: end, hang, or go on with what it saw last."""
REST = 1e-6
"""By how much joints at rest may miss their goals [rad]."""
GOALS = np.array([[0.2, -1.4, 0.9, -1.5, -1.5, 0.2], [0.5, -1.2, 1.2, -1.5, -1.2, 0.4], [0.1, -1.3, 1.0, -1.8, -1.5, -0.2]])
SET_TCP: Any = 29
"""A command of the simulated controller, which the driver never sends."""


@pytest.fixture(scope="module")
def simulated():
    """Left as it was found: no fault, no change of its settings."""
    with SimulatedController.start(seed=3, time_scale=20.0) as found:
        yield found


@pytest.fixture
def changed():
    """For one test alone, which changes it."""
    with SimulatedController.start(seed=3, time_scale=20.0) as found:
        yield found


@pytest.fixture
def slow():
    """Real time, for faults in the middle of a motion."""
    with SimulatedController.start(seed=3, time_scale=1.0) as found:
        yield found


@pytest.mark.both_clients
def test_it_goes_where_it_is_sent_and_says_where_it_is(connect, client, simulated):
    with connect(simulated) as robot:
        description = robot.description()
        assert description["model"] == "UR5e" and description["software"].startswith("5.")
        assert description["client"] == versioned(client, {"koala": "koala-capture", "ur_rtde": "ur-rtde"}[client])
        stamps = []
        for goal in GOALS:
            robot.move_to(goal, speed=1.0, acceleration=1.4)
            state = robot.state()
            np.testing.assert_allclose(state.joints, goal, atol=REST)
            assert np.abs(state.joint_speeds).max() < 1e-3
            np.testing.assert_allclose(state.base_from_flange, forward(goal), atol=6 * REST)  # six joints, links of up to a metre
            distance, angle = pose.difference(state.base_from_flange, simulated.true_base_from_flange())
            assert 0 < distance < 3e-5 * 6 and angle < np.radians(0.005) * 6  # three axes, each within 3.5 deviations
            stamps.append((state.robot_time_s, state.host_time_ns))
        assert np.diff(stamps, axis=0).min() > 0


@pytest.mark.both_clients
def test_the_tool_offset_is_removed(connect, changed):
    other = KoalaClient(changed.host, frequency=125.0, watchdog_hz=1.0)
    assert other._order(SET_TCP, [0.01, 0.02, 0.1, 0.0, 0.3, 0.0]) and other._done(1.0)
    other.leave()
    with connect(changed) as robot:
        robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)
        np.testing.assert_allclose(robot.description()["tcp_offset"], [0.01, 0.02, 0.1, 0, 0.3, 0], atol=1e-9)
        np.testing.assert_allclose(robot.state().base_from_flange, forward(GOALS[0]), atol=1e-6)


def test_an_arm_as_built_reports_its_own_kinematics(connect):
    with SimulatedController.start(seed=3, length_error_mm=1.0, angle_error_deg=0.05) as simulated, connect(simulated) as robot:
        robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)
        reported, true = robot.state().base_from_flange, simulated.true_base_from_flange()
        assert pose.difference(reported, true)[0] < 2e-4 < pose.difference(forward(GOALS[0]), true)[0]


def test_an_unsafe_target_moves_nothing(connect, simulated):
    with connect(simulated) as robot:
        before = robot.state().joints
        with pytest.raises(SafetyError):
            robot.move_to(FAR, speed=5.0, acceleration=1.4)
        np.testing.assert_array_equal(robot.state().joints, before)
        robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)


@pytest.mark.parametrize(
    ("fault", "arguments", "error", "words"),
    [
        pytest.param("protective_stop", {}, ProtectiveStop, "protective stop: the arm stands still", marks=VENDORS),
        ("emergency_stop", {}, NotReady, "safety status ROBOT_EMERGENCY_STOP"),
        pytest.param("safeguard", {}, NotReady, "safety status SAFEGUARD_STOP.*close the fence", marks=VENDORS),
        ("safeguard", {"mode": "TP_THREE_POSITION_ENABLING_STOP"}, NotReady, "THREE_POSITION_ENABLING_STOP.*close the fence"),
        pytest.param("stop_program", {}, MotionError, "program was stopped", marks=VENDORS),
        pytest.param("drop", {}, RigConnectionError, "lost|broke down", marks=pytest.mark.both_clients),
        ("silent", {"seconds": 60}, RigConnectionError, "data stream stands still"),
    ],
)
def test_a_fault_in_motion_leaves_the_arm_stopped_and_one_clear_error(connect, slow, fault, arguments, error, words):
    with pytest.raises(error, match=words) as caught, connect(slow) as robot:
        with in_motion(slow, lambda: slow.ask(fault, **arguments)):
            robot.move_to(FAR, **UNHURRIED)
    assert "\n" not in str(caught.value) and slow.host in str(caught.value)
    assert stopped_on_its_way(slow)


@pytest.mark.both_clients
def test_a_safeguard_that_lets_go_by_itself_does_not_set_the_arm_in_motion_again(connect, slow):
    with pytest.raises(CaptureError, match=r"the robot (is|was) stopped for safety"), connect(slow) as robot:
        with in_motion(slow, lambda: slow.ask("safeguard", seconds=0.5)):
            robot.move_to(FAR, **UNHURRIED)
    until(lambda: slow.ask("truth")["safety"] == "NORMAL", "the safeguard to let go")
    assert stopped_on_its_way(slow) and not slow.ask("truth")["program_running"]


@pytest.mark.both_clients
def test_after_a_lost_connection_the_driver_can_enter_again(connect, slow):
    robot = connect(slow)
    with pytest.raises(CaptureError), robot:  # lost while idle, or noticed when the motion is refused
        slow.ask("drop")
        robot.move_to(FAR, **UNHURRIED)
    with robot:
        robot.move_to(robot.state().joints + 0.05, speed=1.0, acceleration=1.4)


@VENDORS
def test_a_killed_client_is_noticed_and_the_arm_stops(connect, slow):
    with pytest.raises(RigConnectionError), connect(slow) as robot, in_motion(slow, robot._link.process.kill):
        robot.move_to(FAR, **UNHURRIED)
    assert stopped_on_its_way(slow)


@pytest.mark.both_clients
def test_stop_from_another_thread(connect, slow):
    with connect(slow) as robot:
        with in_motion(slow, robot.stop), pytest.raises(MotionError, match="stopped on request"):
            robot.move_to(FAR, **UNHURRIED)
        until(lambda: rests(slow), "the arm at rest")
        start = robot.state().joints
        with pytest.raises(StopLatched, match=r"stopped on request .*until it is cleared"):
            robot.move_to(start + 0.02, speed=1.0, acceleration=1.4)
        robot.stop()
        robot.clear_stop()
        robot.move_to(start + 0.02, speed=1.0, acceleration=1.4)  # the connection is still good


def test_a_stop_between_motions_and_before_entering_again_holds(connect, simulated):
    robot = connect(simulated)
    with robot:
        robot.stop()
    with robot:
        before = robot.state().joints
        with pytest.raises(StopLatched):
            robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)
        np.testing.assert_array_equal(robot.state().joints, before)


@VENDORS
def test_another_reply_than_stopped_is_no_stop_and_the_message_says_how_the_arm_moves(connect, slow):
    with pytest.raises(MotionError) as caught, connect(slow) as robot:
        slow.ask("refuse_stop")
        slow.ask("ignore_commands")
        robot.deadlines = replace(robot.deadlines, accept_s=0.3)
        robot.move_to(FAR, **UNHURRIED)
    line = str(caught.value)
    words = r"refuses to stop its program \('Failed to execute: stop'\); the arm stood still \d+\.\d s ago.*stop it there"
    assert re.search(words, line), line


@VENDORS
def test_a_stop_that_nothing_confirms_asks_for_the_emergency_stop(connect, slow):
    with connect(slow) as robot:
        slow.ask("hang", seconds=600)
        until(lambda: _age_s(robot) > robot.deadlines.stale_s, "a state that says nothing of what the arm does now")
        with pytest.raises(RigConnectionError, match=r"nothing confirms that the arm stops .*press the emergency stop"):
            robot.stop()
        slow.ask("hang", seconds=0)


def _age_s(robot):
    """Of the newest state."""
    return 1e-9 * (time.monotonic_ns() - robot._link.newest.content["host_time_ns"])


def test_an_arm_with_noisy_encoders_settles(connect):
    with SimulatedController.start(seed=3, time_scale=4.0, noise_rad=ENCODER_NOISE_RAD) as simulated, connect(simulated) as robot:
        robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)
        states = [robot.state(newer_than_ns=time.monotonic_ns()) for _ in range(12)]
    noise = np.std(np.subtract([state.joints for state in states], GOALS[0]))
    assert 0.5 < noise / ENCODER_NOISE_RAD < 1.5  # 72 draws: 8 % standard error
    assert np.diff([state.robot_time_s for state in states]).min() > 0


def test_an_arm_that_never_rests_names_its_spread_and_the_key(connect):
    with pytest.raises(MotionError, match=r"does not come to rest: its joints vary by .* limit 1\.0e-09.*motion\.settle_spread"):
        with SimulatedController.start(time_scale=20.0, noise_rad=1e-5) as noisy, connect(noisy) as robot:
            robot.settling = Settling(spread=1e-9, timeout_s=0.5)
            robot.move_to(robot.state().joints + 0.02, speed=1.0, acceleration=1.4)


@pytest.mark.both_clients
def test_the_arm_stops_when_the_whole_program_is_killed(client, slow):
    code = """if True:
        import sys
        from koala3d.capture.drivers.ur.link import Deadlines
        from koala3d.capture.drivers.ur.robot import UniversalRobot
        with UniversalRobot(sys.argv[1], client=sys.argv[2], deadlines=Deadlines(stale_s=1.0, watchdog_hz=1.0)) as robot:
            print("ready", flush=True)
            robot.move_to([2.0, -1.2, 0.8, -1.5, -1.0, 0.2], speed=0.4, acceleration=1.4)
    """
    program = subprocess.Popen([sys.executable, "-c", code, slow.host, client], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None and program.stdout.readline() == "ready\n"
    until(lambda: moves(slow), "the middle of its motion")
    program.kill()
    program.communicate()
    assert stopped_on_its_way(slow)


def test_the_same_seed_gives_the_same_poses_bit_for_bit(connect):
    visits = []
    for time_scale in (20.0, 10.0):
        with SimulatedController.start(seed=5, time_scale=time_scale) as simulated, connect(simulated) as robot:
            robot.move_to(GOALS[0], speed=1.0, acceleration=1.4)
            until(lambda: _quiet(simulated), "an arm that has stopped to swing: settled means by less than a limit")
            state = robot.state(newer_than_ns=time.monotonic_ns())
            visits.append((state.base_from_flange, simulated.true_base_from_flange()))
    np.testing.assert_array_equal(*visits)


def _quiet(simulated):
    truth = simulated.ask("truth")
    return truth["phase_s"] > truth["motion_s"] + QUIET_S


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_motion_stops_the_arm(connect, slow):
    with pytest.raises(KeyboardInterrupt), connect(slow) as robot:
        with in_motion(slow, lambda: os.kill(os.getpid(), signal.SIGINT)):
            robot.move_to(FAR, **UNHURRIED)
    assert stopped_on_its_way(slow)


def test_an_exception_in_the_block_stops_and_closes(connect, simulated):
    robot = connect(simulated)
    with pytest.raises(ZeroDivisionError), robot:
        raise ZeroDivisionError
    with pytest.raises(RigConnectionError, match="not connected"):
        robot.state()
    robot.close()


def test_entering_a_stopped_robot_says_so_and_leaves_nothing_open(connect, changed):
    changed.ask("protective_stop")
    with pytest.raises(NotReady, match="safety status PROTECTIVE_STOP"), connect(changed):
        pytest.fail("entered a robot that cannot move")
    assert not changed.ask("truth")["program_running"]


def test_an_unreachable_controller_is_one_clear_line():
    with pytest.raises(RigConnectionError, match=r"cannot be reached .*robot\.host"), UniversalRobot("127.9.9.9"):
        pytest.fail("entered a robot that is not there")


@pytest.mark.both_clients
def test_a_second_owner_is_refused_and_the_first_goes_on(connect, simulated):
    with connect(simulated) as first:
        with pytest.raises(NotReady, match=r"a program runs on the robot and was left alone"), connect(simulated):
            pytest.fail("entered a robot that another program controls")
        first.move_to(first.state().joints + 0.01, speed=0.5, acceleration=1.0)


@pytest.mark.both_clients
def test_taking_over_from_a_client_that_holds_its_registers_is_refused(connect, simulated):
    with connect(simulated) as first:
        words = r"does not take the control program .*end the other program"
        with pytest.raises(CaptureError, match=words), connect(simulated, take_over=True):
            pytest.fail("entered a robot that another program controls")
        del first
