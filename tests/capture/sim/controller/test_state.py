"""What a safeguard does to the program that runs."""

import time

import numpy as np

from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.drivers.ur.rtde.program import FIRST, Command
from koala3d.capture.sim.controller.installation import Installation
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.state import Controller
from tests.moments import until

HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])


def test_a_safeguard_pauses_the_motion_and_lets_it_go_on_by_itself() -> None:
    controller = Controller(SimulatedArm(0, HOME, 0.0, 0.0), 20.0, Installation(), print)
    controller.upload(program.text())
    controller.write_inputs({f"input_double_register_{FIRST + i}": one for i, one in enumerate([*(HOME + 1), 0.1, 1.4])})
    controller.write_inputs({f"input_int_register_{FIRST + 1}": 1, f"input_int_register_{FIRST}": int(Command.MOVE)})
    assert controller.arm.moving(controller.now) and controller.program_running
    controller.arm.safety, controller.guarded_until = SafetyMode.SAFEGUARD_STOP, time.monotonic() + 0.1
    controller.step()
    assert controller.program_paused and not controller.program_running

    def goes_on() -> bool:
        controller.step()
        return controller.program_running

    until(goes_on, "the safeguard to let go")
    assert controller.arm.safety is SafetyMode.NORMAL
    until(lambda: not controller.arm.moving(controller.now), "the end of the motion")
    np.testing.assert_allclose(controller.arm.target(controller.now)[0], HOME + 1)


def test_an_input_that_is_not_simulated_ends_the_program_with_its_name() -> None:
    said = list[str]()
    controller = Controller(SimulatedArm(0, HOME, 0.0, 0.0), 20.0, Installation(), said.append)
    controller.upload(program.text())
    controller.write_inputs({"external_force_torque": [0.0] * 6})
    assert said == ["the program was ended: input external_force_torque is not simulated"] and not controller.program_running
