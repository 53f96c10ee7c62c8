"""Replies of the dashboard in the words that the vendor's client looks for."""

from types import SimpleNamespace

import numpy as np
import pytest

from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode
from koala3d.capture.sim.controller.dashboard import reply
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm


@pytest.fixture
def controller():
    found = SimpleNamespace(
        arm=SimulatedArm(0, np.zeros(6), 0.0, 0.0),
        installed=Installation(version=(5, 11, 5, 7)),
        unstoppable=False,
        program_running=True,
        program_paused=False,
        stopped=0,
    )
    found.stop_program = lambda: setattr(found, "stopped", found.stopped + 1)
    found.pause_program, found.play_program = lambda: found.program_running, lambda: found.program_paused
    return found


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("PolyscopeVersion", "URSoftware 5.11.5.7 (simulated)"),
        ("is in remote control", "true"),
        ("running", "Program running: true"),
        ("robotmode", "Robotmode: RUNNING"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("nonsense", "could not understand: 'nonsense'"),
    ],
)
def test_answers(controller, question, answer):
    assert reply(controller, question + "\n") == answer


def test_the_serial_number_is_digits(controller):
    assert reply(controller, "get serial number").isdigit()


def test_stop_stops(controller):
    assert reply(controller, "stop") == "Stopped" and controller.stopped == 1


def test_pause_and_play_fail_where_there_is_nothing_to_do(controller):
    assert reply(controller, "pause") == "Pausing program" and reply(controller, "play") == "Failed to execute: play"
    controller.program_running, controller.program_paused = False, True
    assert (
        reply(controller, "programState") == "PAUSED rtde_control.urp"
        and reply(controller, "running") == "Program running: false"
    )
    assert reply(controller, "pause") == "Failed to execute: pause" and reply(controller, "play") == "Starting program"


def test_the_way_back_from_stops(controller):
    controller.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP, 0.0)
    assert reply(controller, "safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert reply(controller, "unlock protective stop") == "Protective stop releasing" and controller.arm.may_move
    controller.arm.stop_for_safety(SafetyMode.ROBOT_EMERGENCY_STOP, 0.0)
    reply(controller, "brake release")
    assert controller.arm.mode is RobotMode.POWER_OFF
    reply(controller, "power on")
    reply(controller, "brake release")
    assert controller.arm.may_move
