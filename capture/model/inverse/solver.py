"""Inverse kinematics of an arm: EAIK where it knows a decomposition, our own closed form for the UR family, or iteration.

EAIK (Ostermeier et al., "Automatic geometric decomposition for analytical inverse kinematics", 2025) decomposes arms with six
joints. One with seven becomes such an arm when a joint is held; it is held at many angles in turn.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.inverse import numerical, ur
from koala3d.datasets import pose
from koala3d.datasets.kinematics import Links, forward

Array = NDArray[np.float64]
Solver = Callable[[Array], Array]
HELD_ANGLES = 24  # of the joint that is held, evenly spaced within its limits
EXACT = 1e-6  # branches that miss the pose by more are left out [m, rad]


def solver_for(links: Links, family: str, lower: Array, upper: Array) -> tuple[str, Solver]:
    """The best solver for an arm, with its name: "eaik", "ur" or "numerical".

    It gives (m, n) joint angles of every branch that it finds, wherever the limits of the joints are.

    Args:
        family: "ur" where the links are those of Universal Robots, of any lengths.
        lower, upper: (n,) limits of the joints [rad].
    """
    found = _decomposed(links, lower, upper)
    if found is not None:
        return "eaik", found
    if family == "ur":
        return "ur", lambda target: ur.branches(target, links)
    return "numerical", lambda target: numerical.solutions(target, links, lower, upper)


def branches(base_from_flange: Array, links: Links, solver: Solver, *, family: str) -> Array:
    """(m, n) joint angles [rad, -pi..pi] of every branch of `solver` that does reach the (4, 4) pose; m = 0: none.

    Next to a singularity, and out of reach, a solver may return angles that miss the pose. The order is the same for the same
    branches. For the UR family: shoulder behind the base axis first, then sin q5 > 0, then sin q3 > 0.
    """
    target = np.ascontiguousarray(base_from_flange, np.float64)
    found = _reaching(solver(target), target, links)
    found = np.arctan2(np.sin(found), np.cos(found))
    if family != "ur":
        return found[np.lexsort(np.round(found, 6).T[::-1])]
    wrist = target[:3, 3] - links.d[5] * target[:3, 2]
    ahead = np.cos(found[:, 0]) * wrist[0] + np.sin(found[:, 0]) * wrist[1] > 0
    return found[np.lexsort((found[:, 2] < 0, found[:, 4] < 0, ahead))]


def _reaching(joints: Array, target: Array, links: Links) -> Array:
    """Those of (m, n) joint angles that are finite and reach the (4, 4) pose."""
    joints = joints[np.isfinite(joints).all(axis=1)]
    distance, angle = pose.difference(forward(joints, links), target)
    return joints[(distance < EXACT) & (angle < EXACT)]


def _decomposed(links: Links, lower: Array, upper: Array) -> Solver | None:
    """A solver by EAIK; None where it is not installed or knows no decomposition of the arm."""
    try:
        from eaik.IK_DH import DhRobot
    except ImportError:
        return None
    if links.count == 6:
        robots = [DhRobot(links.alpha, links.a, links.d)]
    elif links.count == 7:
        robots = _held(DhRobot, links, lower, upper)
    else:
        return None
    if not robots or not robots[0].hasKnownDecomposition():
        return None
    first, last = pose.inverse(links.base), pose.inverse(links.tool)

    def solve(target: Array) -> Array:
        plain = np.ascontiguousarray(first @ target @ last)
        found = [np.array(robot.IK(plain).Q, np.float64).reshape(-1, links.count) for robot in robots]
        joints = _reaching(np.concatenate(found) - links.theta, target, links)
        # near the edge of its reach an arm with seven joints may have solutions between the angles of the held one only
        return joints if len(joints) or len(robots) == 1 else numerical.solutions(target, links, lower, upper)

    return solve


def _held(make: Callable[..., Any], links: Links, lower: Array, upper: Array) -> list[Any]:
    """Arms with seven joints of which one is held, at many angles; none where no such arm can be decomposed."""
    for joint in range(links.count - 1, -1, -1):
        if make(links.alpha, links.a, links.d, [(joint, 0.3)]).hasKnownDecomposition():
            low, high = max(lower[joint], -np.pi), min(upper[joint], np.pi)
            angles = low + (np.arange(HELD_ANGLES) + 0.5) / HELD_ANGLES * (high - low)
            return [make(links.alpha, links.a, links.d, [(joint, angle + links.theta[joint])]) for angle in angles]
    return []
