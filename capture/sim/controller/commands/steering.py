"""Motions that go on while the client steers them: servoJ and servoL, speedJ and speedL, jogging, and moving until contact."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.kinematics import Joints
from koala3d.capture.sim.controller.commands.inverse import inverse
from koala3d.capture.sim.controller.commands.registers import Action, Body, ProgramError, Registers
from koala3d.capture.sim.controller.motions.followed import JointDrift, following
from koala3d.capture.sim.controller.motions.profiles import Profile
from koala3d.capture.sim.controller.motions.tool_paths import Drift
from koala3d.capture.sim.controller.motions.tracking import Tracked

Array = NDArray[np.float64]
BASE, TOOL = 0, 1  # features of a jog; any other one is the client's own


SERVO, SPEED, JOG, CONTACT = ("servoJ", "servoL"), ("speedJ", "speedL"), ("jogStart",), ("moveUntilContact",)
"""Calls that are carried out by one thread: the later one replaces what the earlier one wanted."""


def _steer(at: Registers, name: str, thread: tuple[str, ...], wanted: Array, make: Callable[[Joints, Joints], Profile]) -> None:
    """Go over to what a call wants, if it is new: `make` gives the motion from (n,) angles and speeds."""
    at.require_free(*thread)
    if not np.isfinite(wanted).all():
        raise ProgramError(f"{name} has numbers that are not finite")
    if at.steering == name and at.steered is not None:
        profile, held = at.steered
        if profile is at.arm.profile and np.array_equal(held, wanted):
            return
    profile = make(*at.arm.heading(at.now))
    at.arm.begin(profile, at.now, goes_on=bool(at.steering))
    at.steering, at.steered = name, (profile, wanted)


def _servo(at: Registers, name: str, goal: Callable[[], Joints]) -> None:
    wanted = at.arguments(0, 11)

    def make(angles: Joints, speeds: Joints) -> Profile:
        target = goal()
        if not at.arm.model.inside(target):
            raise ProgramError(f"{name}: {at.arm.model.outside(target)}")
        return following(angles, speeds, target, max(wanted[9], 0.02), at.arm.model.speed)

    _steer(at, name, SERVO, wanted, make)


def _speed_joints(at: Registers) -> None:
    wanted, acceleration = at.arguments(0, 6), max(at.number(6), 1e-3)

    def make(angles: Joints, speeds: Joints) -> Profile:
        top = at.arm.model.speed
        last = np.clip(wanted, -top, top)
        return JointDrift(angles, speeds, last, float(np.abs(last - speeds).max()) / acceleration)

    _steer(at, "speedJ", SPEED, at.arguments(0, 7), make)


def _drift(at: Registers, name: str, thread: tuple[str, ...], velocity: Array, acceleration: float) -> None:
    """Bring the tool to a (6,) velocity in the base [m/s, rad/s], which it keeps."""

    def make(angles: Joints, speeds: Joints) -> Profile:
        tool, step = at.arm.tool, max(acceleration, 1e-3)
        first = tool.velocity(angles, speeds)
        change = velocity - first
        ramp = float(max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:]))) / step
        return Tracked(Drift(tool.place(angles), first, velocity, ramp), tool, angles)

    _steer(at, name, thread, np.array([*velocity, acceleration]), make)


def _jog(at: Registers) -> None:
    """Both halves of the velocity are given in the axes of the base, of the tool as it is now, or of a pose."""
    feature = round(at.number(6))
    axes = at.arm.base_from_tcp(at.joints) if feature == TOOL else at.pose(8)
    turn = np.eye(3) if feature == BASE else axes[:3, :3]
    velocity = np.concatenate([turn @ at.arguments(0, 3), turn @ at.arguments(3, 3)])
    _drift(at, "jogStart", JOG, velocity, at.number(7))


def _until_contact(at: Registers) -> Body:
    """Nothing is ever touched: it goes on until the program is stopped or the arm is at a limit."""
    _drift(at, "moveUntilContact", CONTACT, at.arguments(0, 6), at.number(12))
    while True:
        yield


def _end(at: Registers, names: tuple[str, ...]) -> Body:
    """Slow down: evenly in the joints after speedJ, on the tool's path after the others [rad/s^2, m/s^2]."""
    deceleration = 1.2 if names == JOG else at.number(0)
    at.require_free(*names)
    if at.steering == "speedJ":
        at.arm.stop(deceleration, at.now)
    else:
        at.arm.stop_tool(deceleration, at.now)
    at.steering, at.steered = "", None
    return at.until_rest()


ACTIONS: dict[int, Action] = {
    9: _speed_joints,
    10: lambda at: _drift(at, "speedL", SPEED, at.arguments(0, 6), at.number(6)),
    11: lambda at: _servo(at, "servoJ", lambda: at.arguments(0, 6)),
    24: lambda at: _servo(at, "servoL", lambda: inverse(at.arm, at.pose(0), at.arm.target(at.now)[0])),
    15: lambda at: _end(at, SPEED),
    16: lambda at: _end(at, SERVO),
    41: _jog,
    42: lambda at: _end(at, JOG),
    51: _until_contact,
}
