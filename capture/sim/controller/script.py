"""What can be seen from outside of the control program that a client uploads; the vendor's and ours share these registers.

The client writes a command number into input_int_register_0 and its arguments into the registers after it; the program
answers 1 (ready) and 2 (done) in output_int_register_0 and results in the other output registers. A new command is one
more function with `@command(number)`.
"""

import re
from collections.abc import Callable, Generator

import numpy as np
from numpy.typing import NDArray

from capture import kinematics
from capture.sim.controller.arm import Arm, Safety
from capture.sim.controller.profiles import Line
from datasets import pose

READY, DONE, END = 1, 2, 255
Handler = Callable[["ControlProgram", float], "Generator[None] | None"]
COMMANDS: dict[int, Handler] = {}
EVERY_CYCLE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands that are carried out in every cycle while they are in the register, and never answered with done."""


def command(*numbers: int) -> Callable[[Handler], Handler]:
    """Register the function as the body of these commands; a generator blocks the program until it ends."""

    def register(handler: Handler) -> Handler:
        COMMANDS.update(dict.fromkeys(numbers, handler))
        return handler

    return register


class ControlProgram:
    """One uploaded program with its registers. `offset` is 24 where the client uses the upper registers."""

    def __init__(self, arm: Arm, text: str) -> None:
        self.arm = arm
        found = re.search(r"#\s*int register offset.*\n\s*(?:[a-z_]+\s*=\s*)?(\d+)", text)
        self.offset = 24 if found and found[1] == "24" else 0
        self.running, self.paused, self.now = True, False, 0.0
        self.watchdog_s: float | None = None
        self.input_ints, self.input_doubles = [0] * 48, [0.0] * 48
        self.output_ints, self.output_doubles = [0] * 48, [0.0] * 48
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

    def answer(self, values: object = (), flag: int | bool | None = None) -> None:
        """Write the result registers."""
        numbers = np.asarray(values, np.float64).ravel()
        self.output_doubles[self.offset : self.offset + len(numbers)] = numbers.tolist()
        if flag is not None:
            self.output_ints[self.offset + 1] = int(flag)

    def cycle(self, now: float) -> None:
        """What the program does in one cycle at controller time `now` [s]."""
        self.now = now
        if not self.running or self.paused:
            return
        if self._moving and not self.arm.moving(now):
            self.report_operation(running=False)
        if self._body is not None:
            self._resume()
            return
        number = self.int_argument(0)
        if number == 0:
            self._executing = False
            self._state(READY)
        elif number == END:
            self.end(now)
        elif number in EVERY_CYCLE:
            if number in COMMANDS:
                COMMANDS[number](self, now)
            self._state(READY)
        elif not self._executing:
            self._executing = True
            self._body = COMMANDS[number](self, now) if number in COMMANDS else None
            if self.running:  # a program that fails never says done
                self._resume()

    def end(self, now: float) -> None:
        """The program ends; the arm slows down."""
        self.running, self.paused, self._body = False, False, None
        self.arm.stop(3.0, now)

    def report_operation(self, *, running: bool, started: bool = False) -> None:
        """Report the asynchronous motion to the client: id in bits 24-30, writes in 16-22, running in 15."""
        self._moving = running
        self._operation = (self._operation + started) % 128
        self._writes = (self._writes + 1) % 128
        self.output_ints[self.offset + 2] = self._operation << 24 | self._writes << 16 | int(running) << 15

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


@command(1, 4)
def _move_joints(program: ControlProgram, now: float) -> Generator[None] | None:
    goal, (speed, acceleration) = program.arguments(0, 6), program.arguments(6, 2)
    if np.isfinite(goal).all() and not program.arm.reaches(goal):
        program.end(now)
        return None
    program.arm.move_to(goal, speed, acceleration, now)
    return _motion(program)


@command(2)
def _move_to_pose(program: ControlProgram, now: float) -> Generator[None] | None:
    speed, acceleration = program.arguments(6, 2)
    goal = _nearest_branch(program, program.arguments(0, 6), program.arm.target(now)[0])
    if goal is None or not program.arm.reaches(goal):
        program.end(now)
        return None
    program.arm.move_to(goal, speed, acceleration, now)
    return _motion(program)


@command(3)
def _move_line(program: ControlProgram, now: float) -> Generator[None] | None:
    speed, acceleration = program.arguments(6, 2)
    start = program.arm.target(now)[0]
    path, distance = _line(program, start, program.arguments(0, 6))
    if path is None:
        program.end(now)
        return None
    program.arm.begin(Line(path, distance, max(speed, 1e-3), max(acceleration, 1e-3)), now)
    return _motion(program)


def _motion(program: ControlProgram) -> Generator[None] | None:
    if program.int_argument(1):
        program.report_operation(running=True, started=True)
        return None
    return _until_rest(program)


def _until_rest(program: ControlProgram) -> Generator[None]:
    while program.arm.moving(program.now):
        yield


@command(33, 34)
def _stop(program: ControlProgram, now: float) -> Generator[None] | None:
    program.arm.stop(float(program.arguments(0, 1)[0]), now)
    return None if program.int_argument(1) else _until_rest(program)


@command(15, 16)
def _speed_stop(program: ControlProgram, now: float) -> Generator[None] | None:
    program.arm.stop(float(program.arguments(0, 1)[0]), now)
    return _until_rest(program)


@command(29)
def _set_tcp(program: ControlProgram, now: float) -> None:
    numbers = program.arguments(0, 6)
    program.arm.flange_from_tcp = pose.from_rotation_vector(numbers[3:], numbers[:3])


@command(40)
def _tcp_offset(program: ControlProgram, now: float) -> None:
    program.answer(_numbers(program.arm.flange_from_tcp))


@command(31)
def _protective_stop(program: ControlProgram, now: float) -> None:
    program.arm.stop_for_safety(Safety.PROTECTIVE_STOP, now)


@command(35)
def _watchdog(program: ControlProgram, now: float) -> None:
    program.watchdog_s = 1.0 / max(float(program.arguments(0, 1)[0]), 1e-3)


@command(37)
def _joints_within_limits(program: ControlProgram, now: float) -> None:
    program.answer(flag=bool((np.abs(program.arguments(0, 6)) <= kinematics.JOINT_LIMIT).all()))


@command(39)
def _pose_trans(program: ControlProgram, now: float) -> None:
    first, second = program.arguments(0, 6), program.arguments(6, 6)
    product = pose.from_rotation_vector(first[3:], first[:3]) @ pose.from_rotation_vector(second[3:], second[:3])
    program.answer(_numbers(product))


@command(28)
def _target_waypoint(program: ControlProgram, now: float) -> None:
    program.answer(_numbers(program.arm.base_from_tcp(program.arm.profile.at(np.inf)[0])))


@command(43)
def _forward(program: ControlProgram, now: float) -> None:
    program.answer(_numbers(program.arm.base_from_tcp(program.arm.actual(now)[0])))


@command(58)
def _flange_pose(program: ControlProgram, now: float) -> None:
    program.answer(_numbers(kinematics.forward(program.arm.actual(now)[0], program.arm.links)))


@command(30, 46)
def _inverse(program: ControlProgram, now: float) -> None:
    near = program.arguments(6, 6) if program.int_argument(0) == 30 else program.arm.actual(now)[0]
    solution = _nearest_branch(program, program.arguments(0, 6), near)
    if solution is None:
        program.end(now)
        return
    program.answer(solution)


@command(36, 60, 61)
def _has_inverse(program: ControlProgram, now: float) -> None:
    program.answer(flag=_nearest_branch(program, program.arguments(0, 6), program.arm.actual(now)[0]) is not None)


@command(47)
def _is_steady(program: ControlProgram, now: float) -> None:
    program.answer(flag=bool((np.abs(program.arm.actual(now)[1]) < 1e-3).all()))


def _numbers(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([transform[:3, 3], pose.rotation_vector(transform)])


def _nearest_branch(
    program: ControlProgram, tcp_numbers: NDArray[np.float64], near: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Joint angles nearest to `near` that bring the tool point to a pose with the arm's true links; None: out of reach."""
    base_from_tcp = pose.from_rotation_vector(tcp_numbers[3:], tcp_numbers[:3])
    base_from_flange = base_from_tcp @ pose.inverse(program.arm.flange_from_tcp)
    branches = kinematics.inverse(base_from_flange)
    if not len(branches):
        return None
    branches = kinematics.nearest_turn(branches, near)
    joints = branches[np.abs(branches - near).max(axis=1).argmin()]
    for _ in range(5):  # the closed form has the nominal links: a few Newton steps lead to the true ones
        reached = kinematics.forward(joints, program.arm.links)
        turn = pose.rotation_vector(base_from_flange[:3, :3] @ reached[:3, :3].T)
        step = np.concatenate([base_from_flange[:3, 3] - reached[:3, 3], turn])
        joints = joints + np.linalg.lstsq(kinematics.jacobian(joints, program.arm.links), step, rcond=1e-9)[0]
    return joints


def _line(
    program: ControlProgram, start: NDArray[np.float64], tcp_numbers: NDArray[np.float64]
) -> tuple[NDArray[np.float64] | None, float]:
    """(n, 6) joint angles along the straight line of the tool point to a pose, and its length [m]; None: it leaves the reach."""
    begin = program.arm.base_from_tcp(start)
    end = pose.from_rotation_vector(tcp_numbers[3:], tcp_numbers[:3])
    turn = pose.rotation_vector(begin[:3, :3].T @ end[:3, :3])
    length = float(np.linalg.norm(end[:3, 3] - begin[:3, 3]))
    path, count = [start], max(int(length / 0.005), 8)
    for share in np.linspace(0, 1, count + 1)[1:]:
        between = begin[:3, :3] @ pose.from_rotation_vector(turn * share)[:3, :3]
        numbers = np.concatenate([begin[:3, 3] + share * (end[:3, 3] - begin[:3, 3]), pose.rotation_vector(between)])
        joints = _nearest_branch(program, numbers, path[-1])
        if joints is None or np.abs(joints - path[-1]).max() > 0.5:
            return None, length
        path.append(joints)
    return np.array(path), max(length, float(np.linalg.norm(turn)) * 0.1, 1e-6)
