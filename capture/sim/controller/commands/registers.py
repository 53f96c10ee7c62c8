"""What a command sees: its arguments, the arm, and the registers that it answers in."""

from collections.abc import Callable, Generator

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.kinematics import Joints, pose_from_six
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.motions.profiles import Profile

REGISTERS = 48  # of each kind and direction
Body = Generator[None]
"""What a command still has to do: it is resumed once in every cycle until it ends, and the program is blocked until then."""
Action = Callable[["Registers"], "Body | None"]
Answer = Callable[["Registers"], "Joints | bool | int"]


class ProgramError(Exception):
    """The program cannot go on."""


class Registers:
    """The registers of one program, and the thread that moves the arm. `offset` is 24 where the upper registers are used."""

    def __init__(self, arm: SimulatedArm, text: str, offset: int) -> None:
        self.arm, self.text, self.offset, self.now = arm, text, offset, 0.0
        self.watchdog_s: float | None = None
        self.input_ints, self.input_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self.output_ints, self.output_doubles = [0] * REGISTERS, [0.0] * REGISTERS
        self.steering = ""
        """The call that goes on moving the arm until another one ends it; empty: none."""
        self.steered: tuple[Profile, NDArray[np.float64]] | None = None
        """Its motion, and the numbers that it came with."""
        self.operation: Body | None = None
        """An asynchronous motion or stop that is under way."""
        self._number, self._writes = 0, 0

    def int_argument(self, index: int) -> int:
        """Integer argument of the current command."""
        return self.input_ints[self.offset + index]

    def arguments(self, first: int, count: int) -> NDArray[np.float64]:
        """(count,) numeric arguments of the current command."""
        start = self.offset + first
        return np.array(self.input_doubles[start : start + count])

    def number(self, index: int) -> float:
        """Numeric argument of the current command."""
        return self.input_doubles[self.offset + index]

    def pose(self, first: int) -> NDArray[np.float64]:
        """(4, 4) of six numeric arguments: position [m] and rotation vector [rad]."""
        return pose_from_six(self.arguments(first, 6))

    @property
    def joints(self) -> Joints:
        """(6,) angles that the encoders measure now [rad]."""
        return self.arm.actual(self.now)[0]

    def report_operation(self, *, running: bool, started: bool = False, progress: int = 0) -> None:
        """Report the asynchronous motion: its number in bits 24-30, writes in 16-22, running in 15, waypoint in 0-14."""
        self._number = (self._number + started) % 128
        self._writes = (self._writes + 1) % 128
        self.output_ints[self.offset + 2] = self._number << 24 | self._writes << 16 | int(running) << 15 | progress

    def require_free(self, *goes_on: str) -> None:
        """Return if a motion may begin. Raises ProgramError: a thread of the program still moves the arm, or a person does.

        Args:
            goes_on: calls whose thread may be the one that moves it, since this motion changes what that thread does.
        """
        if self.arm.freedrive:
            raise ProgramError("the arm is in freedrive: endFreedriveMode or endTeachMode comes before a motion")
        if self.steering and self.steering not in goes_on:
            raise ProgramError(f"another thread already moves the arm: {self.steering} goes on until it is ended")
        if goes_on and self.operation is not None:
            raise ProgramError("another thread already moves the arm: an asynchronous motion is under way")

    def until_rest(self) -> Body:
        """Goes on until the arm stands still."""
        while self.arm.moving(self.now):
            yield

    def follow(self, body: Body) -> Body | None:
        """What is left to do after a motion began: all of `body`, or nothing if the client does not wait for the end."""
        if not self.int_argument(1):
            if self.operation is not None:
                self.operation = None
                self.report_operation(running=False)
            return body
        self.operation = body
        self.report_operation(running=True, started=True)
        return None
