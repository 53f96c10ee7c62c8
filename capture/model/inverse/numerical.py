"""Inverse kinematics of any arm by damped least squares from random starts (Nakamura and Hanafusa 1986; Wampler 1986).

Each start follows

    step = J^T (J J^T + damping^2 I)^-1 error

where the damping shrinks with the error, so that the last steps are Newton's. What is found is a sample of the solutions: an arm
with six joints has finitely many, and a few may be missed; one with more joints has infinitely many.
"""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.kinematics import Links, forward, jacobian

Array = NDArray[np.float64]

STARTS, STEPS = 48, 60
LONGEST_STEP = 0.6  # of the fastest joint [rad]
REACHED = 1e-10  # errors below this count as none [m, rad]
SAME_RAD = 1e-4  # solutions that differ by less are one
NEWTON_STEPS, FARTHEST = 6, 0.5
"""Of `improved`: errors of centimetres are squared in each step; and how far an angle may go [rad]."""


def solutions(base_from_flange: Array, links: Links, lower: Array, upper: Array, *, seed: int = 0) -> Array:
    """(m, n) joint angles [rad] that bring the flange to the (4, 4) pose; m = 0: none was found.

    Args:
        lower, upper: (n,) limits of the joints [rad], inside which starts are drawn and solutions kept; infinite ones are
            replaced by half a turn.
    """
    low, high = np.maximum(lower, -2 * np.pi), np.minimum(upper, 2 * np.pi)
    start, end = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    joints = np.random.default_rng(seed).uniform(np.minimum(start, end), np.maximum(start, end), (STARTS, links.count))
    for _ in range(STEPS):
        error = _error(base_from_flange, joints, links)
        size = np.linalg.norm(error, axis=-1)
        active = size > REACHED
        if not active.any():
            break
        motion = jacobian(joints[active], links)
        damping = np.minimum(0.05 * size[active], 0.1) ** 2 + 1e-18
        square = motion @ np.swapaxes(motion, -1, -2) + damping[:, None, None] * np.eye(6)
        step = (np.swapaxes(motion, -1, -2) @ np.linalg.solve(square, error[active, :, None]))[..., 0]
        fastest = np.abs(step).max(-1, keepdims=True)
        joints[active] = np.clip(joints[active] + step * np.minimum(1.0, LONGEST_STEP / np.maximum(fastest, 1e-12)), low, high)
    reached = np.linalg.norm(_error(base_from_flange, joints, links), axis=-1) < 1e-8
    return _distinct(joints[reached])


def improved(base_from_flange: Array, joints: Array, links: Links) -> Array:
    """Those of (m, n) joint angles [rad], solutions with similar links, that Newton's method brings onto the (4, 4) pose.

    Next to a singularity a step would be long; angles that leave their branch, or do not converge, are left out.
    """
    found = joints.copy()
    for _ in range(NEWTON_STEPS):
        step = np.linalg.pinv(jacobian(found, links)) @ _error(base_from_flange, found, links)[..., None]
        found = found + np.clip(step[..., 0], -FARTHEST, FARTHEST)
    good = np.linalg.norm(_error(base_from_flange, found, links), axis=-1) < 1e-8
    return found[good & (np.abs(found - joints).max(axis=-1, initial=0.0) < FARTHEST)]


def _error(base_from_flange: Array, joints: Array, links: Links) -> Array:
    """(m, 6) what is left to the pose: translation [m], rotation vector [rad], in the base."""
    reached = forward(joints, links)
    turn = base_from_flange[:3, :3] @ np.swapaxes(reached[:, :3, :3], -1, -2)
    return np.concatenate([base_from_flange[:3, 3] - reached[:, :3, 3], pose.rotation_vector(turn)], axis=-1)


def _distinct(joints: Array) -> Array:
    kept: list[Array] = []
    for one in joints:
        turns = [np.abs(np.angle(np.exp(1j * (one - other)))).max() for other in kept]
        if all(turn > SAME_RAD for turn in turns):
            kept.append(one)
    return np.array(kept, np.float64).reshape(-1, joints.shape[-1])
