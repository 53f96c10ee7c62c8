"""The driver on a controller without a dashboard server, as PolyScope X is."""

import contextlib
import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError, MotionError, NotReady, ProtectiveStop, RigConnectionError, StopLatched
from koala3d.capture.drivers.ur.interfaces import robot_api
from koala3d.capture.drivers.ur.interfaces.robot_api import RobotApi
from koala3d.capture.drivers.ur.pendant import connect as connect_pendant
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.drivers.ur.stand_in import program_state
from koala3d.capture.sim.controller.process import SimulatedController
from tests.capture.moving import FAR, UNHURRIED, in_motion, moves, stopped_on_its_way
from tests.moments import until

NEAR = np.array([0.2, -1.4, 0.9, -1.5, -1.5, 0.2])


API = pytest.mark.skipif(os.geteuid() != 0, reason="the Robot API has port 80, which only root may open")


@pytest.fixture
def simulated():
    with SimulatedController.start(seed=3, time_scale=1.0) as found:
        found.ask("install", dashboard=False, version=[10, 7, 0, 0])
        yield found


def test_a_program_that_is_pausing_or_resuming_has_not_ended():
    assert [program_state(number) for number in (1, 2, 3, 4, 5)] == ["STOPPED", "PLAYING", "PAUSED", "PAUSED", "PLAYING"]


def test_it_goes_where_it_is_sent(simulated):
    with UniversalRobot(simulated.host) as robot:
        about = robot.description()
        assert (about["model"], about["serial"], about["software"]) == ("UR5e", "unknown", "10.7.0")
        assert about["client"].startswith("koala ")
        goal = robot.state().joints + 0.05
        robot.move_to(goal, speed=1.0, acceleration=1.4)
        np.testing.assert_allclose(robot.state().joints, goal, atol=1e-6)  # where joints at rest may miss their goals
    assert not simulated.ask("truth")["program_running"]


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_stops_the_arm(simulated):
    with pytest.raises(KeyboardInterrupt), UniversalRobot(simulated.host) as robot:
        with in_motion(simulated, lambda: os.kill(os.getpid(), signal.SIGINT)):
            robot.move_to(FAR, **UNHURRIED)
    assert stopped_on_its_way(simulated)


def test_the_stop_does_not_need_the_client(simulated):
    """The program that takes the place of the running one: what is left where the client hangs."""
    with pytest.raises(MotionError, match=r"stopped or paused .*the (arm was stopped|controller runs no program)"):
        with UniversalRobot(simulated.host) as robot:
            pendant = connect_pendant(simulated.host)
            with in_motion(simulated, pendant.stop):
                robot.move_to(FAR, **UNHURRIED)
    assert stopped_on_its_way(simulated) and pendant.stop() == "no program runs"
    pendant.close()


def test_a_controller_that_goes_on_is_named(simulated):
    with UniversalRobot(simulated.host) as robot:
        simulated.ask("refuse_stop")
        simulated.ask("ignore_commands")
        with pytest.raises(MotionError, match=r"refused to stop its program, which still runs \('its program goes on'\)"):
            robot.move_to(NEAR, speed=1.0, acceleration=1.4)


def test_the_order_to_stop_is_sent_where_no_state_arrives(simulated):
    with UniversalRobot(simulated.host) as robot:
        pendant = connect_pendant(simulated.host)
        threading.Thread(target=_move, args=(robot,), daemon=True).start()
        until(lambda: moves(simulated), "the middle of its motion")
        simulated.ask("silent", seconds=60)
        with pytest.raises(RigConnectionError, match="no sample within a second"):
            pendant.stop()
        assert stopped_on_its_way(simulated)


def _move(robot):
    with contextlib.suppress(CaptureError):
        robot.move_to(FAR, **UNHURRIED)


def test_a_stop_holds(simulated):
    with UniversalRobot(simulated.host) as robot:
        robot.stop()
        with pytest.raises(StopLatched):
            robot.move_to(NEAR, speed=1.0, acceleration=1.4)


def test_a_protective_stop_is_named_in_motion_and_before(simulated):
    with pytest.raises(ProtectiveStop), UniversalRobot(simulated.host) as robot:
        with in_motion(simulated, lambda: simulated.ask("protective_stop")):
            robot.move_to(FAR, **UNHURRIED)
    with pytest.raises(NotReady, match="safety status PROTECTIVE_STOP"), UniversalRobot(simulated.host):
        pytest.fail("entered a robot that cannot move")


def test_a_program_that_runs_is_left_alone_unless_taken_over(simulated):
    simulated.ask("install", dashboard=False, version=[10, 7, 0, 0], program="PLAYING")
    with pytest.raises(NotReady, match=r"a program runs on the robot and was left alone .*PLAYING"):
        UniversalRobot(simulated.host).__enter__()
    with UniversalRobot(simulated.host, take_over=True) as robot:
        robot.move_to(robot.state().joints + 0.05, speed=1.0, acceleration=1.4)


def test_the_vendors_client_is_refused_with_a_remedy(simulated):
    with pytest.raises(NotReady, match=r"ur_rtde needs the dashboard server .*PolyScope X has none.*robot\.client: koala"):
        UniversalRobot(simulated.host, client="ur_rtde").__enter__()


def test_without_primary_interface_it_cannot_be_reached(simulated):
    simulated.ask("install", dashboard=False, primary=False)
    with pytest.raises(RigConnectionError):
        UniversalRobot(simulated.host).__enter__()


@API
def test_the_robot_api_says_who_it_is_and_who_has_control(simulated):
    simulated.ask("install", dashboard=False, version=[10, 14, 0, 0])
    with UniversalRobot(simulated.host) as robot:
        assert robot.description()["serial"] == "20235500001"
    simulated.ask("install", dashboard=False, version=[10, 12, 0, 0], remote=False)
    with pytest.raises(NotReady, match="the robot is in local control"):
        UniversalRobot(simulated.host).__enter__()


@API
@pytest.mark.parametrize(
    ("version", "known"),
    [
        ([10, 7, 0, 0], None),
        ([10, 11, 0, 0], RobotApi("3.0.0", "STOPPED")),
        ([10, 12, 0, 0], RobotApi("3.1.4", "STOPPED", "RUNNING", "NORMAL", "REMOTE", "AUTOMATIC")),
        ([10, 14, 1, 0], RobotApi("5.0.107", "STOPPED", "RUNNING", "NORMAL", "REMOTE", "AUTOMATIC", "20235500001", "10.14.1")),
    ],
)
def test_each_version_of_the_robot_api_says_what_it_knows(simulated, version, known):
    simulated.ask("install", dashboard=False, version=version)
    assert robot_api.ask(simulated.host) == known


@API
def test_the_robot_api_stops_a_program_in_remote_control_only(simulated):
    simulated.ask("install", dashboard=False, version=[10, 14, 0, 0], program="PLAYING", remote=False)
    assert not robot_api.stop(simulated.host) and robot_api.ask(simulated.host).program_state == "PLAYING"
    simulated.ask("install", dashboard=False, version=[10, 14, 0, 0], program="PLAYING")
    assert robot_api.stop(simulated.host) and robot_api.ask(simulated.host).program_state == "STOPPED"
    assert not robot_api.stop(simulated.host)  # 409: nothing runs


@API
def test_the_robot_api_stops_what_the_program_at_the_primary_interface_does_not(simulated):
    simulated.ask("install", dashboard=False, version=[10, 14, 0, 0], program="PLAYING", deaf_primary=True)
    pendant = connect_pendant(simulated.host)
    assert pendant.stop() == "Stopped"


def test_nobody_answers_as_a_robot_api_where_there_is_none():
    assert robot_api.ask("127.9.9.9") is None and not robot_api.stop("127.9.9.9")


def test_the_arm_stops_when_the_program_is_killed(simulated):
    code = f"""if True:
        from koala3d.capture.drivers.ur.robot import UniversalRobot
        with UniversalRobot({simulated.host!r}) as robot:
            print("ready", flush=True)
            robot.move_to({FAR.tolist()}, speed=0.4, acceleration=1.4)
    """
    program = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert program.stdout is not None and program.stdout.readline() == "ready\n"
    until(lambda: moves(simulated), "the middle of its motion")
    program.kill()
    program.communicate()
    assert stopped_on_its_way(simulated)
