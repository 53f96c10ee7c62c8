"""The control program itself: its text, and what it does when it is run against the simulated arm.

The program uses a part of URScript that is Python except for `end`, `thread`, `run`, `kill`, `global` and `local`. These are
translated, and the controller's functions act on the simulated arm, one cycle at a time.
"""

import re
import threading

import numpy as np
import pytest

from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.drivers.ur.rtde.program import DONE, FIRST, READY, RUNNING_BIT, Command
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.script import ControlProgram
from koala3d.datasets import pose

HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
GOAL = HOME + 0.5
CYCLE_S = 0.002
DOCUMENTED = {
    "end_freedrive_mode",
    "freedrive_mode",
    "get_tcp_offset",
    "movej",
    "read_input_float_register",
    "read_input_integer_register",
    "rtde_set_watchdog",
    "stopj",
    "sync",
    "write_output_float_register",
    "write_output_integer_register",
}
"""Functions of the script manual that the program may call."""


class Killed(BaseException):
    """Ends a thread of the program."""


class ScriptThread:
    """One thread of the program; runs in turns with the others, until it waits for the next cycle."""

    def __init__(self, body):
        self.alive, self.killed, self.error = True, False, None
        self._go, self._waits = threading.Semaphore(0), threading.Semaphore(0)
        threading.Thread(target=self._run, args=(body,), daemon=True).start()

    def turn(self):
        if self.alive:
            self._go.release()
            assert self._waits.acquire(timeout=10)
        if self.error is not None:
            raise self.error

    def wait(self):
        self._waits.release()
        self._go.acquire()
        if self.killed:
            raise Killed

    def _run(self, body):
        self._go.acquire()
        try:
            body()
        except Killed:
            pass
        except Exception as error:
            self.error = error
        self.alive = False
        self._waits.release()


class Controller:
    """What the program sees of a controller; `cycle` runs every thread until it waits."""

    def __init__(self):
        self.arm = SimulatedArm(0, HOME, 0.0, 0.0)
        self.now, self.watchdog = 0.0, None
        self.ints, self.floats = {FIRST: 0}, {}
        self.output_ints, self.output_floats = {}, {}
        self.functions = {
            "read_input_integer_register": self.ints.__getitem__,
            "read_input_float_register": self.floats.__getitem__,
            "write_output_integer_register": self.output_ints.__setitem__,
            "write_output_float_register": self.output_floats.__setitem__,
            "get_tcp_offset": lambda: [0.01, 0.02, 0.1, 0.0, 0.3, 0.0],
            "freedrive_mode": lambda: setattr(self.arm, "freedrive", True),
            "end_freedrive_mode": lambda: setattr(self.arm, "freedrive", False),
            "rtde_set_watchdog": lambda *arguments: setattr(self, "watchdog", arguments),
            "movej": self._movej,
            "stopj": self._stopj,
            "sync": self._wait,
        }
        assert set(self.functions) == DOCUMENTED
        namespace = {**self.functions, "run": self._run, "kill": lambda thread: setattr(thread, "killed", True)}
        exec(compile(_python(program.text()), "control program", "exec"), namespace)
        self.threads: list[ScriptThread] = []
        self.main = self._run(namespace["koala_control"])

    def cycle(self, seconds=CYCLE_S):
        for _ in range(round(seconds / CYCLE_S)):
            self.now += CYCLE_S
            for thread in list(self.threads):
                self.current = thread
                thread.turn()

    def order(self, command, arguments=()):
        self.floats.update({FIRST + index: float(number) for index, number in enumerate(arguments)})
        self.ints.update({FIRST + 1: 1, FIRST: int(command)})

    def finish(self, within_s=5.0):
        """Cycles until the command is done and taken back [s]."""
        begun = self.now
        while self.state != DONE:
            self.cycle()
            assert self.now - begun < within_s
        took = self.now - begun
        self.ints[FIRST] = Command.NONE
        self.cycle()
        self.cycle()
        assert self.state == READY
        return took

    @property
    def state(self):
        return self.output_ints[FIRST]

    @property
    def progress(self):
        """(number, writes, under way)."""
        value = self.output_ints[FIRST + 2]
        return value >> 24, value >> 16 & 127, bool(value & RUNNING_BIT)

    def _run(self, body):
        self.threads.append(ScriptThread(body))
        return self.threads[-1]

    def _wait(self):
        self.current.wait()

    def _movej(self, goal, a, v):
        self.arm.move_to(np.array(goal), v, a, self.now)
        self._until_rest()

    def _stopj(self, a):
        self.arm.stop(a, self.now)
        self._until_rest()

    def _until_rest(self):
        self._wait()
        while self.arm.moving(self.now):
            self._wait()


def _python(text):
    names = sorted(set(re.findall(r"^\s*global (\w+)", text, re.M)))
    lines = []
    for line in text.splitlines():
        indent, content = re.findall(r"^(\s*)(.*)$", line)[0]
        if content == "end" or content.startswith("#"):
            continue
        content = re.sub(r"^(global|local) ", "", content)
        content = re.sub(r"^thread ", "def ", content)
        content = re.sub(r"\brun (\w+)\(\)", r"run(\1)", content)
        content = re.sub(r"^kill (\w+)", r"kill(\1)", content)
        lines.append(indent + content)
        if content.startswith("def "):
            lines.append(f"{indent}  global {', '.join(names)}")
    return "\n".join(lines)


@pytest.fixture
def controller():
    found = Controller()
    found.cycle(0.01)
    assert found.state == READY and found.progress == (0, 1, False)
    return found


def test_blocks_are_balanced_and_the_last_end_stands_alone():
    depth = 0
    for line in filter(None, program.text().splitlines()):
        content = line.strip()
        if content == "end":
            depth -= 1
        assert len(line) - len(line.lstrip()) == 2 * (depth - content.startswith("elif")), line
        assert depth >= 0
        depth += content.endswith(":") and not content.startswith("elif")
    assert depth == 0 and program.text().endswith("\nend\n")


def test_only_documented_functions_and_own_ones_are_called():
    text = re.sub(r'#.*|"[^"]*"', "", program.text())
    own = set(re.findall(r"(?:def|thread) (\w+)\(", text))
    assert set(re.findall(r"(\w+)\(", text)) == own | DOCUMENTED
    assert "{" not in text and text.isascii()


def test_the_simulated_controller_finds_the_registers():
    assert ControlProgram(SimulatedArm(0, HOME, 0.0, 0.0), program.text()).offset == FIRST == 24


def test_a_motion_is_answered_at_once_and_reported_until_it_ends(controller):
    controller.order(Command.MOVE, [*GOAL, 1.0, 1.4])
    assert controller.finish() <= 2 * CYCLE_S
    assert controller.progress == (1, 2, True)
    controller.cycle(controller.arm.profile.duration + 0.1)
    assert controller.progress == (1, 3, False)
    np.testing.assert_allclose(controller.arm.target(controller.now)[0], GOAL)


def test_a_command_is_carried_out_once(controller):
    controller.order(Command.MOVE, [*GOAL, 1.0, 1.4])
    controller.cycle(3.0)
    assert controller.state == DONE and controller.progress == (1, 3, False)  # the register still holds the command


def test_stop_ends_the_motion_and_is_answered_at_rest(controller):
    controller.order(Command.MOVE, [*GOAL, 1.0, 1.4])
    controller.finish()
    controller.cycle(0.4)
    speed = np.abs(controller.arm.target(controller.now)[1]).max()
    controller.order(Command.STOP, [3.0])
    assert controller.finish() == pytest.approx(speed / 3.0, abs=0.01)
    assert controller.progress == (1, 3, False) and not controller.arm.moving(controller.now)
    rests = controller.arm.target(controller.now)[0]
    controller.cycle(1.0)
    np.testing.assert_array_equal(controller.arm.target(controller.now)[0], rests)  # the killed motion does not continue
    assert 0.1 < np.abs(rests - GOAL).max() < 0.5


def test_stop_at_rest_does_nothing(controller):
    controller.order(Command.STOP, [3.0])
    assert controller.finish() <= 2 * CYCLE_S and controller.progress == (0, 1, False)


def test_a_motion_replaces_the_one_under_way(controller):
    for goal in (GOAL, HOME - 0.3):
        controller.order(Command.MOVE, [*goal, 1.0, 1.4])
        controller.finish()
        controller.cycle(0.3)
    assert controller.progress[0] == 2
    controller.cycle(3.0)
    np.testing.assert_allclose(controller.arm.target(controller.now)[0], HOME - 0.3)
    assert not controller.progress[2]


def test_numbers_begin_again_after_127(controller):
    for _ in range(130):
        controller.order(Command.MOVE, [*controller.arm.target(controller.now)[0], 1.0, 1.4])
        controller.finish()
        controller.cycle(0.01)
    assert controller.progress[0] == 2 and 0 <= controller.output_ints[FIRST + 2] < 1 << 31


def test_watchdog_and_tool_offset(controller):
    controller.order(Command.WATCHDOG, [5.0])
    controller.finish()
    assert controller.watchdog == (f"input_int_register_{FIRST}", 5.0, "stop")
    controller.order(Command.TCP_OFFSET)
    controller.finish()
    np.testing.assert_allclose([controller.output_floats[FIRST + i] for i in range(6)], controller.functions["get_tcp_offset"]())


def test_a_command_left_by_an_earlier_client_is_not_carried_out():
    controller = Controller()
    controller.order(Command.MOVE, [*GOAL, 1.0, 1.4])
    controller.cycle(0.1)
    assert controller.state == 0 and not controller.arm.moving(controller.now)
    controller.ints[FIRST] = Command.NONE
    controller.cycle(0.01)
    assert controller.state == READY and controller.progress[0] == 0


def test_end_stops_the_arm_and_the_program(controller):
    controller.order(Command.MOVE, [*GOAL, 1.0, 1.4])
    controller.finish()
    controller.cycle(0.3)
    controller.order(Command.END)
    controller.cycle(1.0)
    assert not controller.main.alive and not controller.arm.moving(controller.now)
    assert np.abs(controller.arm.target(controller.now)[0] - GOAL).max() > 0.1


def test_it_answers_as_the_simulated_program_does(controller):
    """One session of the driver, with both: the same numbers of motions, the same results, the same places."""
    simulated = ControlProgram(SimulatedArm(0, HOME, 0.0, 0.0), program.text())
    simulated.arm.flange_from_tcp = pose.from_rotation_vector([0.0, 0.3, 0.0], [0.01, 0.02, 0.1])
    orders = [
        (Command.WATCHDOG, [5.0]),
        (Command.TCP_OFFSET, []),
        (Command.MOVE, [*GOAL, 1.0, 1.4]),
        (Command.MOVE, [*HOME, 1.0, 1.4]),
    ]
    for command, arguments in orders:
        controller.order(command, arguments)
        controller.finish()
        controller.cycle(2.0)
        simulated.input_doubles[FIRST : FIRST + len(arguments)] = list(arguments)
        for number, now in ((command, controller.now - 2.0), (Command.NONE, controller.now)):
            simulated.input_ints[FIRST : FIRST + 2] = [number, 1]
            simulated.cycle(now)
        simulated.cycle(controller.now)
        assert simulated.output_ints[FIRST] == controller.state == READY
        theirs = simulated.output_ints[FIRST + 2]
        assert (theirs >> 24, bool(theirs & RUNNING_BIT)) == (controller.progress[0], controller.progress[2])
        end, expected = (arm.target(controller.now)[0] for arm in (controller.arm, simulated.arm))
        np.testing.assert_allclose(end, expected, atol=1e-12)
    results = [controller.output_floats[FIRST + index] for index in range(6)]
    np.testing.assert_allclose(results, simulated.output_doubles[FIRST : FIRST + 6], atol=1e-12)
    assert simulated.watchdog_s == 1 / controller.watchdog[1]
