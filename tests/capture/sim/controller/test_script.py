"""The handshake of the control program, register by register."""

import numpy as np

from koala3d.capture.sim.controller.commands.table import EVERY_CYCLE
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.script import DONE, END, READY, ControlProgram

HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])


def _program(text="def rtde_control():\nend\n"):
    return ControlProgram(SimulatedArm(0, HOME, 0.0, 0.0), text)


def _order(program, number, arguments=(), flag=0, now=0.0):
    program.input_doubles[: len(arguments)] = list(arguments)
    program.input_ints[:2] = [number, flag]
    program.cycle(now)
    return program.output_ints[0]


def test_a_blocking_move_is_ready_until_it_is_done():
    program = _program()
    assert _order(program, 0) == READY
    assert _order(program, 1, [*(HOME + 0.5), 1.0, 1.0]) == READY
    program.cycle(0.5)
    assert program.output_ints[0] == READY and program.arm.moving(0.5)
    program.cycle(5.0)
    assert program.output_ints[0] == DONE
    np.testing.assert_allclose(program.arm.target(5.0)[0], HOME + 0.5)


def test_a_command_is_carried_out_once():
    program = _program()
    _order(program, 1, [*(HOME + 0.5), 1.0, 1.0], flag=1)
    program.cycle(9.0)
    started = program.arm.profile
    program.cycle(10.0)
    assert program.arm.profile is started  # the register still holds the order
    assert _order(program, 0, now=10.0) == READY


def test_an_asynchronous_move_reports_its_progress():
    program = _program()
    _order(program, 1, [*(HOME + 0.5), 1.0, 1.0], flag=1)
    running = program.output_ints[2]
    assert running >> 15 & 1 and running >> 24 == 1 and program.output_ints[0] == DONE
    program.cycle(9.0)
    assert not program.output_ints[2] >> 15 & 1 and program.output_ints[2] >> 24 == 1


def test_tool_offset_and_pose():
    program = _program()
    _order(program, 29, [0, 0, 0.1, 0, 0, 0.3])
    _order(program, 0)
    _order(program, 40)
    np.testing.assert_allclose(program.output_doubles[:6], [0, 0, 0.1, 0, 0, 0.3], atol=1e-12)
    _order(program, 0)
    _order(program, 43)
    reported = program.arm.base_from_tcp(HOME)
    np.testing.assert_allclose(program.output_doubles[:3], reported[:3, 3])


def test_a_pose_out_of_reach_ends_the_program():
    program = _program()
    _order(program, 46, [2.0, 0, 0, 0, 0, 0])
    assert not program.running


def test_the_end_stops_the_arm():
    program = _program()
    _order(program, 1, [*(HOME + 0.5), 1.0, 1.0], flag=1)
    program.cycle(0.3)
    _order(program, END, now=0.4)
    assert not program.running and not program.arm.moving(1.0)


def test_upper_registers_are_found_in_the_uploaded_text():
    assert _program("# float register offset\n24\n# int register offset\n24\nend\n").offset == 24
    assert _program("# int register offset\n0\nend\n").offset == 0


def test_commands_of_every_cycle_are_never_done():
    for number in EVERY_CYCLE:
        program = _program()
        assert _order(program, number, [0.3, 0.2, 0.4, 0.0, 2.0, 0.0, 0.5, 0.0, 0.002, 0.1, 300.0]) == READY
        program.cycle(0.1)
        assert program.output_ints[0] == READY
