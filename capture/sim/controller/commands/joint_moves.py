"""moveJ and moveJ_IK: straight lines between joint angles."""

from collections.abc import Sequence

import numpy as np

from koala3d.capture.model.kinematics import Joints
from koala3d.capture.sim.controller.commands.inverse import inverse
from koala3d.capture.sim.controller.commands.registers import Action, Body, ProgramError, Registers
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.capture.sim.controller.motions.blends import JointPath, Schedule, halves, turning
from koala3d.capture.sim.controller.motions.profiles import Trapezoid

HALVINGS = 30


def _move(at: Registers, goal: Joints) -> Body | None:
    at.require_free()
    if np.isfinite(goal).all() and not at.arm.reaches(goal):
        raise ProgramError("a motion leads out of reach")
    speed, acceleration = at.arguments(6, 2)
    at.arm.move_to(goal, speed, acceleration, at.now)
    return at.follow(at.until_rest())


def joint_path(
    arm: SimulatedArm, points: Joints, speeds: Sequence[float], accelerations: Sequence[float], radii: Sequence[float]
) -> JointPath:
    """From the first of (k + 1, n) angles through the others.

    Args:
        speeds, accelerations: of the joint that turns farthest on each leg [rad/s, rad/s^2].
        radii: of the tool around each waypoint, within which the path may be rounded [m]; that of the last one is not used.
    """
    distances = turning(points)
    top = float(arm.model.speed.min())
    legs = tuple(
        Trapezoid(distance, min(max(speed, 1e-3), top), max(acceleration, 1e-3))
        for distance, speed, acceleration in zip(distances, speeds, accelerations, strict=True)
    )
    reached = []
    for number, radius in enumerate(radii[:-1]):
        before, corner, after = points[number : number + 3]
        reached.append((_share(arm, corner, before, radius), _share(arm, corner, after, radius)))
    return JointPath(points, Schedule(legs, halves(distances, [*reached, (0.0, 0.0)])))


def _share(arm: SimulatedArm, corner: Joints, away: Joints, radius: float) -> float:
    """Share of the way from a waypoint to other angles on which the tool is within a radius of the waypoint; half at most."""
    middle = arm.tool.place(corner)[:3, 3]

    def within(share: float) -> bool:
        return float(np.linalg.norm(arm.tool.place(corner + share * (away - corner))[:3, 3] - middle)) <= radius

    low, high = 0.0, 0.5
    if within(high):
        return high
    for _ in range(HALVINGS):
        half = (low + high) / 2
        low, high = (half, high) if within(half) else (low, half)
    return low


ACTIONS: dict[int, Action] = {
    1: lambda at: _move(at, at.arguments(0, 6)),
    2: lambda at: _move(at, inverse(at.arm, at.pose(0), at.arm.target(at.now)[0])),
}
