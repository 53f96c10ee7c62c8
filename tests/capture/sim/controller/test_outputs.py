"""What a recipe reads at one moment."""

import numpy as np
import pytest

from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.drivers.ur.rtde import wire
from koala3d.capture.model.kinematics import forward
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.outputs import Outputs
from koala3d.capture.sim.controller.script import ControlProgram
from koala3d.capture.sim.controller.state import Controller

GOAL = np.array([0.5, -1.2, 0.8, -1.5, -1.0, 0.2])


@pytest.fixture
def controller() -> Controller:
    return Controller(SimulatedArm(0, np.zeros(6) - 0.5, 0.0, 0.0), 1.0, Installation(), report=print)


def test_a_moment_is_one_moment_whatever_is_asked_and_when(controller):
    controller.arm.move_to(GOAL, 1.0, 1.4, 10.0)
    first, later = Outputs(controller, 10.6), Outputs(controller, 10.7)
    np.testing.assert_array_equal(first["actual_q"], controller.arm.actual(10.6)[0])
    np.testing.assert_array_equal(first["target_qd"], controller.arm.target(10.6)[1])
    np.testing.assert_array_equal(first["actual_qd"], first["target_qd"])  # in motion nothing rings
    assert first["timestamp"] == 10.6 and (later["actual_q"] != first["actual_q"]).any()
    np.testing.assert_allclose(first["actual_TCP_pose"][:3], forward(first["actual_q"])[:3, 3], atol=1e-12)


def test_a_tool_pose_costs_nothing_where_nobody_asks(controller, monkeypatch):
    asked = []
    monkeypatch.setattr(controller, "tcp_pose", lambda joints: asked.append(joints) or np.zeros(6))
    moment = Outputs(controller, 1.0)
    assert all(moment[name] is not None for name in ("timestamp", "actual_q", "runtime_state", "output_int_register_3"))
    assert not asked
    assert moment["actual_TCP_pose"].shape == (6,) and len(asked) == 1


def test_registers_are_the_programs(controller):
    assert Outputs(controller, 1.0)["output_int_register_2"] == 0  # nothing runs
    controller.program = ControlProgram(controller.arm, "")
    controller.program.output_ints[2], controller.program.output_doubles[5] = 7, 0.25
    moment = Outputs(controller, 1.0)
    assert (moment["output_int_register_2"], moment["output_double_register_5"], moment["input_int_register_2"]) == (7, 0.25, 0)


def test_states_of_program_and_safety(controller):
    def read() -> tuple[int, int, int]:
        moment = Outputs(controller, 1.0)
        return moment["runtime_state"], moment["robot_status_bits"], moment["safety_status_bits"]

    assert read() == (1, 0b01, 0b1)
    controller.program = ControlProgram(controller.arm, "")
    assert read() == (2, 0b11, 0b1)
    controller.program.paused = True
    assert read() == (4, 0b01, 0b1)
    controller.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP, 1.0)
    assert read()[2] == 1 << 2 | 1 << 10
    controller.arm.stop_for_safety(SafetyMode.ROBOT_EMERGENCY_STOP, 1.0)
    assert read()[1:] == (0, 1 << 6 | 1 << 7 | 1 << 10)


def test_every_variable_has_a_value_that_its_type_can_hold(controller):
    names = [*wire.OUTPUT_TYPES, "output_double_register_0", "input_int_register_47"]
    moment, recipe = Outputs(controller, 1.0), wire.Recipe(names)
    values = recipe.unpack(recipe.pack([moment[name] for name in names]))
    assert values["joint_temperatures"] == [controller.arm.warmth.temperature(1.0)] * 6 and values["payload_cog"] == list(
        Installation().payload_centre
    )
