"""What can be seen from outside of the control program that a client uploads; the vendor's and ours share these registers.

The client writes a command number into input_int_register_0 and its arguments into the registers after it; the program
answers 1 (ready) and 2 (done) in output_int_register_0 and results in the other output registers. `ACTIONS` and `ANSWERS`
are the commands that are simulated; any other one ends the program with the reason.
"""

import logging
import re
from collections.abc import Callable, Generator

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.model import kinematics
from koala3d.capture.model.kinematics import Joints, pose_from_six, six_from_pose
from koala3d.capture.sim.controller.arm import SimulatedArm
from koala3d.capture.sim.controller.urscript import parser
from koala3d.capture.sim.controller.urscript.lexer import ScriptError
from koala3d.datasets import pose

log = logging.getLogger(__name__)
READY, DONE, END = 1, 2, 255
REGISTERS = 48  # of each kind and direction
MAX_PROGRAM = 1 << 18  # bytes; the vendor's program has 50,000, and a path adds 100 per point
EVERY_CYCLE = frozenset({58})
"""Commands that are carried out in every cycle while they are in the register, and never answered with done."""
_STOP = re.compile(r"\s*def \w{1,50}\(\):\s{1,9}stopj\(([\d.]{1,9})\)\s{1,9}end\s*")
_OFFSET = re.compile(r"#\s*int register offset.*\n\s*(?:[a-z_]+\s*=\s*)?(\d{1,20})")
_REGISTER_CALL = re.compile(r"(?:read_input|write_output)_(integer|float|boolean)_register\(\s*(\d{1,20})")


class ProgramError(Exception):
    """The program cannot go on."""


def is_whole(text: bytes | bytearray) -> bool:
    """Whether a program has arrived up to its last line, "end"."""
    return text.endswith(b"\n") and text[-80:].rstrip().endswith(b"\nend")


def check_part(text: bytes | bytearray, *, ended: bool) -> None:
    """Return if what has arrived can become a program, else raise ScriptError. `ended`: nothing follows."""
    begun = text.lstrip()
    if len(text) > MAX_PROGRAM:
        raise ScriptError(f"a program has more than {MAX_PROGRAM} bytes and no end")
    if begun and (ended or b"\n" in begun) and not begun.startswith((b"def ", b"#")):
        line = begun[:60].splitlines()[0].decode("latin-1")
        raise ScriptError(f"not simulated: the line {line!r}; a program begins with 'def'")
    if begun and ended:
        raise ScriptError("a program without its last line, 'end'")


def stop_of(text: str) -> float | None:
    """Deceleration of a program that stops the arm and does nothing else [rad/s^2]; None: it is another program."""
    found = _STOP.fullmatch(text)
    return float(found[1]) if found else None


def check(text: str) -> None:
    """Return if this is the control program of a client. Raises ScriptError: it does not compile, or is not simulated."""
    parser.check(text)
    offset = _OFFSET.search(text)
    if offset is None:
        raise ScriptError("not simulated: a program other than the control program of a client")
    if int(offset[1]) not in (0, REGISTERS // 2):
        raise ScriptError(f"not simulated: a control program with registers from {offset[1]} on")
    for kind, number in _REGISTER_CALL.findall(text):
        if kind == "boolean" or int(number) >= REGISTERS:
            raise ScriptError(f"not simulated: {kind} register {number}, which the program uses")


class ControlProgram:
    """One uploaded program with its registers. `offset` is 24 where the client uses the upper registers.

    `report` receives the reason where the program ends by an error.
    """

    def __init__(self, arm: SimulatedArm, text: str, report: Callable[[str], None] = log.warning) -> None:
        self.arm, self.text, self._report = arm, text, report
        offset = _OFFSET.search(text)
        self.offset = 24 if offset and offset[1] == "24" else 0
        self.running, self.paused, self.now = True, False, 0.0
        self.watchdog_s: float | None = None
        self.input_ints, self.input_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self.output_ints, self.output_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self._executing = False
        self._body: Generator[None] | None = None
        self._operation, self._writes, self._moving = 0, 0, False

    def int_argument(self, index: int) -> int:
        """Integer argument of the current command."""
        return self.input_ints[self.offset + index]

    def arguments(self, first: int, count: int) -> NDArray[np.float64]:
        """(count,) numeric arguments of the current command."""
        start = self.offset + first
        return np.array(self.input_doubles[start : start + count])

    @property
    def joints(self) -> Joints:
        """(6,) angles that the encoders measure now [rad]."""
        return self.arm.actual(self.now)[0]

    def cycle(self, now: float) -> None:
        """What the program does in one cycle at controller time `now` [s]."""
        self.now = now
        if not self.running or self.paused:
            return
        if self._moving and not self.arm.moving(now):
            self.report_operation(running=False)
        number = self.int_argument(0)
        if self._body is not None:
            self._resume()
        elif number == 0:
            self._executing = False
            self._state(READY)
        elif number == END:
            self.end(now)
        elif number in EVERY_CYCLE or not self._executing:
            self._execute(number)

    def end(self, now: float) -> None:
        """The program ends; the arm slows down."""
        self.running, self.paused, self._body = False, False, None
        self.arm.stop(3.0, now)

    def fail(self, reason: str) -> None:
        """The program ends by an error and never says done."""
        self.end(self.now)
        self._report(f"the program was ended: {reason}")

    def report_operation(self, *, running: bool, started: bool = False) -> None:
        """Report the asynchronous motion to the client: id in bits 24-30, writes in 16-22, running in 15."""
        self._moving = running
        self._operation = (self._operation + started) % 128
        self._writes = (self._writes + 1) % 128
        self.output_ints[self.offset + 2] = self._operation << 24 | self._writes << 16 | int(running) << 15

    def _execute(self, number: int) -> None:
        try:
            if number in ACTIONS:
                self._body = ACTIONS[number](self)
            elif number in ANSWERS:
                self._answer(ANSWERS[number](self))
            else:
                raise ProgramError(f"command {number} is not simulated")
        except ProgramError as error:
            self.fail(str(error))
            return
        if number in EVERY_CYCLE:
            self._state(READY)
        else:
            self._executing = True
            self._resume()

    def _answer(self, result: Joints | bool) -> None:
        """Write the result registers: a flag, six numbers, or those of a (4, 4) pose."""
        if isinstance(result, bool):
            self.output_ints[self.offset + 1] = int(result)
        else:
            numbers = six_from_pose(result) if result.ndim == 2 else result
            self.output_doubles[self.offset : self.offset + 6] = numbers.tolist()

    def _resume(self) -> None:
        if self._body is not None:
            try:
                next(self._body)
                return
            except StopIteration:
                self._body = None
        self._state(DONE)

    def _state(self, value: int) -> None:
        self.output_ints[self.offset] = value


def _move(program: ControlProgram, goal: Joints) -> Generator[None] | None:
    if np.isfinite(goal).all() and not program.arm.reaches(goal):
        raise ProgramError("a motion leads out of reach")
    speed, acceleration = program.arguments(6, 2)
    program.arm.move_to(goal, speed, acceleration, program.now)
    if program.int_argument(1):
        program.report_operation(running=True, started=True)
        return None
    return _until_rest(program)


def _until_rest(program: ControlProgram) -> Generator[None]:
    while program.arm.moving(program.now):
        yield


def _stop(program: ControlProgram, *, asynchronous: int = 0) -> Generator[None] | None:
    program.arm.stop(float(program.arguments(0, 1)[0]), program.now)
    return None if asynchronous else _until_rest(program)


def _set_tcp(program: ControlProgram) -> None:
    program.arm.flange_from_tcp = pose_from_six(program.arguments(0, 6))


def _watchdog(program: ControlProgram) -> None:
    program.watchdog_s = 1.0 / max(float(program.arguments(0, 1)[0]), 1e-3)


def _has_inverse(program: ControlProgram) -> bool:
    try:
        return len(_inverse(program, program.joints)) > 0
    except ProgramError:
        return False


def _inverse(program: ControlProgram, near: Joints) -> Joints:
    """Joint angles nearest to `near` that bring the tool point to the pose in the first argument with the true links."""
    base_from_flange = pose_from_six(program.arguments(0, 6)) @ pose.inverse(program.arm.flange_from_tcp)
    branches = program.arm.model.inverse(base_from_flange)
    if not len(branches):
        raise ProgramError("the inverse kinematics of a pose has no solution")
    branches = kinematics.nearest_turn(branches, near)
    joints = branches[np.abs(branches - near).max(axis=1).argmin()]
    for _ in range(5):  # the closed form has the nominal links: a few Newton steps lead to the true ones
        reached = kinematics.forward(joints, program.arm.links)
        turn = pose.rotation_vector(base_from_flange[:3, :3] @ reached[:3, :3].T)
        step = np.concatenate([base_from_flange[:3, 3] - reached[:3, 3], turn])
        joints = joints + np.linalg.lstsq(kinematics.jacobian(joints, program.arm.links), step, rcond=1e-9)[0]
    return joints


ACTIONS: dict[int, Callable[[ControlProgram], "Generator[None] | None"]] = {
    **dict.fromkeys((1, 4), lambda at: _move(at, at.arguments(0, 6))),
    2: lambda at: _move(at, _inverse(at, at.arm.target(at.now)[0])),
    **dict.fromkeys((15, 16), _stop),
    **dict.fromkeys((33, 34), lambda at: _stop(at, asynchronous=at.int_argument(1))),
    29: _set_tcp,
    31: lambda at: at.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP, at.now),
    35: _watchdog,
}
"""What commands do; a generator blocks the program until it ends."""
ANSWERS: dict[int, Callable[[ControlProgram], Joints | bool]] = {
    28: lambda at: at.arm.base_from_tcp(at.arm.profile.at(np.inf)[0]),
    30: lambda at: _inverse(at, at.arguments(6, 6)),
    **dict.fromkeys((36, 60, 61), _has_inverse),
    37: lambda at: bool((np.abs(at.arguments(0, 6)) <= kinematics.JOINT_LIMIT).all()),
    39: lambda at: pose_from_six(at.arguments(0, 6)) @ pose_from_six(at.arguments(6, 6)),
    40: lambda at: at.arm.flange_from_tcp,
    43: lambda at: at.arm.base_from_tcp(at.joints),
    46: lambda at: _inverse(at, at.joints),
    47: lambda at: bool((np.abs(at.arm.actual(at.now)[1]) < 1e-3).all()),
    58: lambda at: kinematics.forward(at.joints, at.arm.links),
}
"""What commands ask for: a flag, six numbers, or a pose."""
