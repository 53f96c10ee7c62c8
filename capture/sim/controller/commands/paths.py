"""Paths: motions along waypoints that the client writes into its program, after which it orders them to be carried out."""

import re
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.kinematics import Joints, pose_from_six
from koala3d.capture.sim.controller.commands.inverse import inverse
from koala3d.capture.sim.controller.commands.joint_moves import joint_path
from koala3d.capture.sim.controller.commands.registers import Action, Body, ProgramError, Registers
from koala3d.capture.sim.controller.commands.tool_moves import tool_path
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.motions.profiles import Chain, Profile, end_of
from koala3d.capture.sim.controller.urscript.lexer import ScriptError

_FUNCTION = re.compile(r"def exec_move_path\(\):\n(.*?)\n\s*end\b", re.DOTALL)
_NUMBER = r"[-+.\deE]{1,25}"
_MOVE = re.compile(
    rf"move(?P<kind>[jlp])\((?P<pose>p?)\[(?P<numbers>{_NUMBER}(?:,{_NUMBER}){{5}})\]"
    rf",a=(?P<a>{_NUMBER}),v=(?P<v>{_NUMBER}),r=(?P<r>{_NUMBER})\)"
)
_SIGNAL = re.compile(r"signal_async_progress\(\d{1,5}\)|textmsg\(.*\)|#.*|")


@dataclass(frozen=True)
class Waypoint:
    """One line of a path: by joint angles or, `is_pose`, by the tool's pose; lines of the tool or, `of_joints`, of the joints."""

    of_joints: bool
    is_pose: bool
    numbers: tuple[float, ...]
    speed: float
    acceleration: float
    radius: float


def waypoints(text: str) -> list[Waypoint]:
    """The path in a program, empty if there is none. Raises ScriptError: it has a line that is not simulated."""
    function, found = _FUNCTION.search(text), list[Waypoint]()
    for number, line in enumerate(function[1].splitlines() if function else []):
        if _SIGNAL.fullmatch(line.strip()):
            continue
        move = _MOVE.fullmatch(line.strip())
        try:
            numbers = [] if move is None else [float(one) for one in (*move["numbers"].split(","), *move.group("v", "a", "r"))]
        except ValueError:
            numbers = []
        if move is None or not np.isfinite(numbers).all() or not numbers:
            place = text[: function.start(1) if function else 0].count("\n") + number + 1
            raise ScriptError(f"not simulated in a path: {line.strip()[:60]!r}", place, 1)
        found.append(Waypoint(move["kind"] == "j", move["pose"] == "p", tuple(numbers[:6]), *numbers[6:]))
    return found


def _along(arm: SimulatedArm, start: Joints, path: list[Waypoint]) -> tuple[Profile, list[float]]:
    """The motion from (n,) angles along a path, and when the motion to each waypoint begins [s].

    Blends join motions of one kind; between lines of the joints and lines of the tool the arm comes to rest.
    """
    motion: Profile | None = None
    begins: list[float] = []
    for of_joints, group in groupby(path, key=lambda one: one.of_joints):
        part = list(group)
        speeds, accelerations, radii = ([getattr(one, name) for one in part] for name in ("speed", "acceleration", "radius"))
        if of_joints:
            points = [start]
            for one in part:
                points.append(inverse(arm, pose_from_six(one.numbers), points[-1]) if one.is_pose else np.array(one.numbers))
            _check(arm, np.array(points[1:]))
            along = joint_path(arm, np.array(points), speeds, accelerations, radii)
            later: Profile = along
            starts = list(along.schedule.starts)
        else:
            poses = [pose_from_six(one.numbers) if one.is_pose else arm.tool.place(np.array(one.numbers)) for one in part]
            later, starts = tool_path(arm, start, np.array(poses), speeds, accelerations, radii)
        passed = 0.0 if motion is None else motion.duration
        begins += [passed + one for one in starts]
        motion = later if motion is None else Chain(motion, later)
        start = end_of(later)
    if motion is None:
        raise ProgramError("the path is empty")
    return motion, begins


def _check(arm: SimulatedArm, points: NDArray[np.float64]) -> None:
    """Raises ProgramError: a waypoint is beyond the limits of a joint, or out of reach."""
    for number, joints in enumerate(points, 1):
        if outside := arm.model.outside(joints):
            raise ProgramError(f"waypoint {number} of the path: {outside}")
        if not arm.reaches(joints):
            raise ProgramError(f"waypoint {number} of the path is out of reach")


def _move(at: Registers) -> Body | None:
    at.require_free()
    path, begins = waypoints(at.text), list[float]()

    def make(start: Joints) -> Profile:
        motion, starts = _along(at.arm, start, path)
        begins.extend(starts)
        return motion

    delay = at.arm.begin_from_rest(make, 3.0, at.now)
    return at.follow(_announce(at, [delay + one for one in begins]))


def _announce(at: Registers, begins: list[float]) -> Body:
    """Report each waypoint when the motion to it begins. As in the client's program, the first report is a new operation."""
    motion = at.arm.profile
    for number, begin in enumerate(begins):
        while at.arm.profile is motion and at.arm.phase(at.now) < begin:
            yield
        if at.arm.profile is motion:
            at.report_operation(running=True, started=number == 0, progress=number)
    yield from at.until_rest()


ACTIONS: dict[int, Action] = {45: _move}
