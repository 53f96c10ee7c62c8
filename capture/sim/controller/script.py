"""What can be seen from outside of the control program that a client uploads; the vendor's and ours share these registers.

The client writes a command number into input_int_register_0 and its arguments into the registers after it; the program
answers 1 (ready) and 2 (done) in output_int_register_0 and results in the other output registers. `commands.table` has the
commands that are simulated; any other one ends the program with the reason.
"""

import logging
import re
from collections.abc import Callable

from koala3d.capture.model.kinematics import Joints, six_from_pose
from koala3d.capture.sim.controller.commands import paths
from koala3d.capture.sim.controller.commands.registers import REGISTERS, Body, ProgramError, Registers
from koala3d.capture.sim.controller.commands.table import ACTIONS, ANSWERS, EVERY_CYCLE, called
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.urscript import parser
from koala3d.capture.sim.controller.urscript.lexer import ScriptError

log = logging.getLogger(__name__)
READY, DONE, END = 1, 2, 255
MAX_PROGRAM = 1 << 18  # bytes; the vendor's program has 50,000, and a path adds 100 per point
ENDED = object()
_STOP = re.compile(r"\s*def \w{1,50}\(\):\s{1,9}stopj\(([\d.]{1,9})\)\s{1,9}end\s*")
_OFFSET = re.compile(r"#\s*int register offset.*\n\s*(?:[a-z_]+\s*=\s*)?(\d{1,20})")
_REGISTER_CALL = re.compile(r"(?:read_input|write_output)_(integer|float|boolean)_register\(\s*(\d{1,20})")


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
    paths.waypoints(text)


class ControlProgram(Registers):
    """One uploaded program: it takes a command from its registers, carries it out, and says so.

    `report` receives the reason where the program ends by an error.
    """

    def __init__(self, arm: SimulatedArm, text: str, report: Callable[[str], None] = log.warning) -> None:
        offset = _OFFSET.search(text)
        super().__init__(arm, text, 24 if offset and offset[1] == "24" else 0)
        self._report = report
        self.running, self.paused = True, False
        self._executing = False
        self._body: Body | None = None

    def cycle(self, now: float) -> None:
        """What the program does in one cycle at controller time `now` [s]."""
        self.now = now
        if not self.running or self.paused:
            return
        if self.operation is not None and not _resumed(self.operation):
            self.operation = None
            self.report_operation(running=False)
        number = self.int_argument(0)
        if self._body is not None:
            self._carry_out()
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
        self.arm.freedrive = False
        self.arm.stop(3.0, now)

    def fail(self, reason: str) -> None:
        """The program ends by an error and never says done."""
        self.end(self.now)
        self._report(f"the program was ended: {reason}")

    def _execute(self, number: int) -> None:
        try:
            if number in ACTIONS:
                self._body = ACTIONS[number](self)
            elif number in ANSWERS:
                self._answer(ANSWERS[number](self))
            else:
                raise ProgramError(f"{called(number)} is not simulated")
        except ProgramError as error:
            self.fail(f"{called(number)}: {error}" if number in (*ACTIONS, *ANSWERS) else str(error))
            return
        if number in EVERY_CYCLE:
            self._state(READY)
        else:
            self._executing = True
            self._carry_out()

    def _answer(self, result: Joints | bool | int) -> None:
        """Write the result registers: a flag or a count, up to six numbers, or those of a (4, 4) pose."""
        if isinstance(result, int):
            self.output_ints[self.offset + 1] = int(result)
        else:
            numbers = six_from_pose(result) if result.ndim == 2 else result
            self.output_doubles[self.offset : self.offset + len(numbers)] = numbers.tolist()

    def _carry_out(self) -> None:
        """One cycle of what the command still has to do; done where nothing is left."""
        try:
            if self._body is not None and _resumed(self._body):
                return
        except ProgramError as error:
            self.fail(f"{called(self.int_argument(0))}: {error}")
            return
        self._body = None
        if self.arm.may_move:  # else the command was answered by a stop for safety, which ends the program
            self._state(DONE)

    def _state(self, value: int) -> None:
        self.output_ints[self.offset] = value


def _resumed(body: Body) -> bool:
    """Whether a command or an operation goes on after one more cycle."""
    return next(body, ENDED) is not ENDED
