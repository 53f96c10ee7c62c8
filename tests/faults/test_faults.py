"""Every fault in the middle of a recording: once with one client, and among the slow tests three times with each.

Checks what the user sees, where the arm is left, and that `--resume` finishes with no frame lost or taken twice.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets.recording import Recording
from tests.capture.moving import FAR, UNHURRIED, in_motion, moves, rests, stopped_on_its_way
from tests.moments import until

pytestmark = pytest.mark.client("koala")
Session = Any
"""See conftest.py."""


def _ask(do: str, **arguments: object) -> Callable[[Session], None]:
    return lambda session: session.controller.ask(do, **arguments) and None


def _limit_the_fastest_joint(session: Session) -> None:
    truth = session.controller.ask("truth")
    joint = int(np.abs(truth["speeds"]).argmax())
    edge = float(np.degrees(truth["joints"][joint])) + float(np.sign(truth["speeds"][joint])) * 0.5
    side = "upper_deg" if truth["speeds"][joint] > 0 else "lower_deg"
    session.controller.ask("joint_limit", joint=joint + 1, **{side: edge})


def _widen_the_limits(session: Session) -> None:
    for joint in range(1, 7):
        session.controller.ask("joint_limit", joint=joint)
    session.at_the_pendant("unlock protective stop", "close safety popup")


@dataclass(frozen=True)
class Fault:
    """What goes wrong, what the user reads, what a person does about it, and the longest time from fault to message [s].

    `client` is the one of `make test`. A fault that is tried with our own here is tried with the vendor's in the middle of a
    single motion, in `tests/capture/drivers/ur/test_robot.py`, and the other way round.
    """

    strike: Callable[[Session], None]
    words: tuple[str, ...]
    mend: Callable[[Session], None] = lambda session: None
    deadline_s: float = 6.0
    client: str = "koala"


RELEASE = "unlock protective stop"
FAULTS = {
    "protective stop": Fault(
        _ask("protective_stop"),
        ("protective stop: the arm stands still", "docs/recovery.md"),
        lambda session: session.at_the_pendant(RELEASE),
    ),
    "emergency stop": Fault(
        _ask("emergency_stop"),
        ("the robot is stopped for safety", "ROBOT_EMERGENCY_STOP", "switch the arm on"),
        lambda session: session.at_the_pendant("power on", "brake release"),
        client="ur_rtde",
    ),
    "safeguard stop": Fault(
        _ask("safeguard"), ("the robot is stopped for safety", "SAFEGUARD_STOP", "close the fence"), _ask("safety")
    ),
    "safeguard that lets go by itself": Fault(
        _ask("safeguard", seconds=0.5),
        ("stopped for safety",),
        lambda session: until(lambda: session.controller.ask("truth")["safety"] == "NORMAL", "the safeguard to let go"),
        client="ur_rtde",
    ),
    "data silent": Fault(
        _ask("silent", seconds=60),
        ("data stream stands still", "the arm was stopped"),
        _ask("silent", seconds=0),
        client="ur_rtde",
    ),
    "controller silent": Fault(
        _ask("hang", seconds=60),
        ("data stream stands still", "the controller does not answer a second connection either", "stops by its own watchdog"),
        _ask("hang", seconds=0),
        deadline_s=10.0,
    ),
    "joint limit": Fault(_limit_the_fastest_joint, ("protective stop: the arm stands still",), _widen_the_limits),
    "unreachable pose": Fault(
        _ask("reach", metres=0.1),
        ("the controller ended its program instead of moving", "cannot reach"),
        _ask("reach", metres=2.0),
        client="ur_rtde",
    ),
    "script ended": Fault(_ask("stop_program"), ("the robot's program was stopped or paused", "the controller runs no program")),
    "program paused": Fault(
        lambda session: session.at_the_pendant("pause"),
        ("the robot's program was stopped or paused", "the arm was stopped"),
        lambda session: session.at_the_pendant("play"),  # too late: the paused program was ended, and nothing moves
        client="ur_rtde",
    ),
}


@pytest.mark.parametrize("times", [1, pytest.param(3, marks=[pytest.mark.slow, pytest.mark.both_clients])])
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.client(FAULTS[name].client)) for name in FAULTS])
def test_in_a_row(session: Session, name: str, times: int) -> None:
    fault = FAULTS[name]
    for repetition in range(times):
        code, words = session.capture_until(fault.strike, after=1 + repetition, resume=repetition > 0)
        took = time.monotonic() - session.happened
        assert code == 1 and words.count("error:") == 1, words
        line = next(line for line in words.splitlines() if line.startswith("error:"))
        assert all(part in line for part in fault.words) and session.controller.host in line, line
        assert took < fault.deadline_s, f"{took:.1f} s from fault to message"
        until(lambda: rests(session.controller), "the arm at rest")
        assert not _incidents(session), "connected again after a stop for safety, or to a controller that is gone"
        assert 1 + repetition <= len(Recording.open(session.out).frames) < session.count
        fault.mend(session)
    code, words = session.capture(resume=True)
    assert code == 0, words
    session.check_whole()


def _incidents(session: Session) -> list[tuple[str, str]]:
    recording = Recording.open(session.out)
    return [(one["view"], one["what"]) for one in recording.manifest.get("incidents", [])]


@pytest.mark.both_clients
def test_a_connection_that_fails_once_is_opened_again_and_the_next_move_is_slow(session: Session) -> None:
    code, words = session.capture_until(_ask("drop"), after=1, resume=False)
    assert code == 0, words
    ((view, what),) = _incidents(session)
    assert what == "connected again" and view in ("001", "002")
    session.check_whole()


@pytest.mark.both_clients
def test_a_connection_that_fails_twice_ends_the_session(session: Session) -> None:
    def drop_twice(at: Session) -> None:
        at.controller.ask("drop")
        until(lambda: _incidents(at), "the session to go on")
        until(lambda: moves(at.controller), "a motion after it")
        at.controller.ask("drop")

    code, words = session.capture_until(drop_twice, after=1, resume=False)
    line = next(line for line in words.splitlines() if line.startswith("error:"))
    assert code == 1 and "connection to the robot" in line and "resume" in line
    assert len(_incidents(session)) == 1
    until(lambda: rests(session.controller), "the arm at rest")
    assert session.capture(resume=True)[0] == 0
    session.check_whole()


@pytest.mark.parametrize("name", ["protective stop", "emergency stop"])
def test_resume_before_the_cause_is_removed_says_so_and_moves_nothing(session: Session, name: str) -> None:
    session.capture_until(FAULTS[name].strike, after=1, resume=False)
    until(lambda: rests(session.controller), "the arm at rest")
    before = session.controller.ask("truth")["joints"]
    code, words = session.capture(resume=True)
    assert code == 1 and words.count("error:") == 1, words
    np.testing.assert_allclose(session.controller.ask("truth")["joints"], before, atol=1e-3)  # it may swing for a moment


def test_speed_slider_makes_it_slower_and_nothing_else(session: Session, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        code, words = session.capture_until(_ask("speed_slider", fraction=0.25), after=5, resume=False)
    assert code == 0, words
    assert "speed slider stands at 25 %: motions take 4.0 times as long" in caplog.text
    session.check_whole()


def test_speed_slider_and_then_a_stop(session: Session) -> None:
    def slow_then_stopped(at: Session) -> None:
        at.controller.ask("speed_slider", fraction=0.02)
        _let_pass(at.controller, 1.0)
        at.controller.ask("stop_program")

    for after in (1, 3, 5):
        code, words = session.capture_until(slow_then_stopped, after=after, resume=after > 1)
        assert code == 1 and "program was stopped" in words, words
        until(lambda: rests(session.controller), "the arm at rest")
        session.controller.ask("speed_slider", fraction=1.0)
    assert session.capture(resume=True)[0] == 0
    session.check_whole()


def _let_pass(controller: SimulatedController, seconds: float) -> None:
    """On the controller's own clock."""
    begun = controller.ask("truth")["robot_time_s"]
    until(lambda: controller.ask("truth")["robot_time_s"] > begun + seconds, "a later time of the controller")


def test_pose_out_of_reach_is_reported_before_anything_moves(session: Session) -> None:
    session.trajectory.write_text(session.trajectory.read_text().replace("[0.40, 0.0, 0.0]", "[1.40, 0.0, 0.0]"))
    before = session.controller.ask("truth")
    code, words = session.capture()
    assert code == 2 and "views cannot be taken" in words and "out of reach, wrist" in words and words.count("\n") == 1, words
    assert session.controller.ask("truth")["joints"] == before["joints"] and not session.out.exists()


def test_joints_beyond_their_range_are_reported_before_anything_moves(session: Session) -> None:
    text = session.trajectory.read_text()
    start = text.index("  - {kind"), text.index("target: {kind")
    session.trajectory.write_text(
        text[: start[0]] + "  - {kind: joints, joints_deg: [[0, -90, 400, -90, 0, 0]]}\n" + text[start[1] :]
    )
    code, words = session.capture()
    assert code == 2 and "joint 3 at 400 degrees, limit 360" in words, words


def test_inverse_kinematics_of_the_vendors_client_ends_the_program_at_an_unreachable_pose() -> None:
    """It returns False or nothing and leaves a stopped program: the reason why the driver sends joint angles only."""
    rtde_control = pytest.importorskip(
        "rtde_control", reason="ur-rtde is not installed: it has no wheel for this Python and platform"
    )

    with SimulatedController.start(time_scale=20.0) as controller:
        client = rtde_control.RTDEControlInterface(controller.host)
        assert not client.moveJ_IK([1.5, 0, 0.3, 0, 3.1, 0], 1.0, 1.4)
        assert not client.isProgramRunning() and not controller.ask("truth")["moving"]
        client.disconnect()


def test_a_motion_of_the_vendors_client_continues_after_pause_and_play() -> None:
    """The reason why the driver ends a paused program: resumed, it would finish the old motion."""
    rtde_control = pytest.importorskip(
        "rtde_control", reason="ur-rtde is not installed: it has no wheel for this Python and platform"
    )
    from dashboard_client import DashboardClient

    with SimulatedController.start(time_scale=2.0) as controller:
        client, dashboard = rtde_control.RTDEControlInterface(controller.host), DashboardClient(controller.host)
        dashboard.connect()
        goal = np.add(controller.ask("truth")["joints"], [0.8, 0, 0, 0, 0, 0])
        assert client.moveJ(goal.tolist(), 0.5, 1.4, True)
        until(lambda: moves(controller), "the middle of the motion")
        dashboard.pause()
        until(lambda: not controller.ask("truth")["moving"], "a paused arm")
        assert dashboard.programState().startswith("PAUSED") and not dashboard.running() and not client.isProgramRunning()
        paused = controller.ask("truth")["joints"]
        assert 0.1 < np.abs(goal - paused).max() < 0.8
        _let_pass(controller, 0.2)
        np.testing.assert_allclose(controller.ask("truth")["joints"], paused, atol=1e-12)
        dashboard.play()
        until(lambda: client.isProgramRunning() and not controller.ask("truth")["moving"], "the end of the old motion")
        np.testing.assert_allclose(controller.ask("truth")["joints"], goal, atol=1e-3)  # it may swing for a moment
        client.disconnect()


def test_a_controller_that_hangs_is_left_stopped_by_its_watchdog(client: str) -> None:
    with SimulatedController.start(time_scale=1.0) as controller:
        robot = UniversalRobot(controller.host, client=client)
        with pytest.raises(CaptureError, match="does not answer a second connection either"), robot:
            with in_motion(controller, lambda: controller.ask("hang", seconds=60)):
                robot.move_to(FAR, **UNHURRIED)
        until(lambda: not controller.ask("truth")["program_running"], "the watchdog")
        assert stopped_on_its_way(controller)
