"""moveL and moveL_FK: straight lines of the tool."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.kinematics import Joints
from koala3d.capture.sim.controller.commands.registers import Action, Body, ProgramError, Registers
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.motions.profiles import Profile, end_of
from koala3d.capture.sim.controller.motions.tool_paths import lines
from koala3d.capture.sim.controller.motions.tracking import Stretched, Tracked

Array = NDArray[np.float64]


def tool_path(
    arm: SimulatedArm,
    start: Joints,
    poses: Array,
    speeds: Sequence[float],
    accelerations: Sequence[float],
    radii: Sequence[float],
) -> tuple[Profile, list[float]]:
    """From (n,) angles along straight lines through (k, 4, 4) poses of the tool, and when each line begins [s].

    If a joint would have to turn faster than it can, the whole motion takes longer.

    Args:
        speeds, accelerations: of the tool on each line [m/s, m/s^2].
        radii: around each waypoint, within which the path may be rounded [m]; that of the last one is not used.

    Raises:
        ProgramError: it leads out of reach, or through a singularity.
    """
    if not np.isfinite(poses).all():
        raise ProgramError("a pose has numbers that are not finite")
    tool = arm.tool
    floor = [max(float(one), 1e-3) for one in speeds], [max(float(one), 1e-3) for one in accelerations]
    path = lines(np.concatenate([tool.place(start)[None], poses]), *floor, radii)
    tracked = Tracked(path, tool, start)
    tracked.solve_until(tracked.duration)
    if np.isfinite(tracked.fault):
        raise ProgramError("the tool's path leads out of reach or through a singularity")
    if not arm.reaches(end_of(tracked)):
        raise ProgramError("a motion leads out of reach")
    factor = max(tracked.fastest, 1.0)
    return Stretched(tracked, factor), [factor * one for one in path.schedule.starts]


def _move(at: Registers, goal: Array) -> Body | None:
    at.require_free()
    speed, acceleration = at.arguments(6, 2)
    at.arm.begin_from_rest(
        lambda start: tool_path(at.arm, start, goal[None], [speed], [acceleration], [0.0])[0], max(acceleration, 1.0), at.now
    )
    return at.follow(at.until_rest())


ACTIONS: dict[int, Action] = {
    3: lambda at: _move(at, at.pose(0)),
    4: lambda at: _move(at, at.arm.tool.place(at.arguments(0, 6))),
}
