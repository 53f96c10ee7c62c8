"""Replies of the dashboard in the words that the vendor's client looks for."""

from types import SimpleNamespace

import numpy as np
import pytest

from capture.sim.arm import Arm, RobotMode, Safety
from capture.sim.dashboard import reply


@pytest.fixture
def controller():
    found = SimpleNamespace(arm=Arm(0, np.zeros(6), 0.0, 0.0), version=(5, 11, 5, 7), program_running=True, stopped=0)
    found.stop_program = lambda: setattr(found, "stopped", found.stopped + 1)
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


def test_the_way_back_from_stops(controller):
    controller.arm.stop_for_safety(Safety.PROTECTIVE_STOP, 0.0)
    assert reply(controller, "safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert reply(controller, "unlock protective stop") == "Protective stop releasing" and controller.arm.may_move
    controller.arm.stop_for_safety(Safety.ROBOT_EMERGENCY_STOP, 0.0)
    reply(controller, "brake release")
    assert controller.arm.mode is RobotMode.POWER_OFF
    reply(controller, "power on"), reply(controller, "brake release")
    assert controller.arm.may_move
