"""Kinematics of the UR5e: joint angles [rad] to `base_from_flange` [m] (`datasets.kinematics`) and back."""

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets import pose
from datasets.kinematics import UR5E as UR5E
from datasets.kinematics import Links as Links
from datasets.kinematics import forward as forward
from datasets.kinematics import jacobian as jacobian
from datasets.kinematics import link_frames as link_frames

Joints = NDArray[np.float64]

JOINT_LIMIT = 2 * np.pi  # range of each joint to either side [rad]
MAX_JOINT_SPEED = np.pi  # of every joint [rad/s]
REACH = 0.85  # from the base axis to the wrist, nominal [m]


def inverse(base_from_flange: ArrayLike) -> Joints:
    """(n, 6) joint angles [rad, -pi..pi] of every branch (up to 8) that reaches the pose with the nominal links; n = 0: none.

    The order is the same whichever solver is installed: shoulder behind the base axis first, then sin q5 > 0, then sin q3 > 0.
    """
    target = np.ascontiguousarray(base_from_flange, np.float64)
    branches = _solver()(target)
    branches = branches[np.isfinite(branches).all(axis=1)]
    reached = forward(branches)  # next to a singularity, and out of reach, a solver may return angles that miss the pose
    distance, angle = pose.difference(reached, target)
    branches = wrap(branches[(distance < 1e-6) & (angle < 1e-6)])
    wrist = target[:3, 3] - UR5E.d[5] * target[:3, 2]
    ahead = np.cos(branches[:, 0]) * wrist[0] + np.sin(branches[:, 0]) * wrist[1] > 0
    return branches[np.lexsort((branches[:, 2] < 0, branches[:, 4] < 0, ahead))]


@lru_cache(1)
def _solver() -> Callable[[Joints], Joints]:
    """EAIK where it is installed, else the closed form of our own: (4, 4) pose to (n, 6) angles."""
    try:
        from eaik.IK_DH import DhRobot
    except ImportError:
        from capture.ur_inverse import branches

        return partial(branches, links=UR5E)
    arm = DhRobot(UR5E.alpha, UR5E.a, UR5E.d)
    return lambda target: np.array(arm.IK(target).Q, np.float64).reshape(-1, 6)


def pose_from_six(numbers: ArrayLike) -> Joints:
    """(4, 4) pose of the six numbers that controllers use: position [m] and rotation vector [rad]."""
    numbers = np.asarray(numbers, np.float64)
    return pose.from_rotation_vector(numbers[3:], numbers[:3])


def six_from_pose(matrix: Joints) -> Joints:
    """(6,) position [m] and rotation vector [rad] of a (4, 4) pose."""
    return np.concatenate([matrix[:3, 3], pose.rotation_vector(matrix)])


def wrap(angles: ArrayLike) -> Joints:
    """Angles [rad] brought to -pi..pi."""
    angles = np.asarray(angles, np.float64)
    return np.arctan2(np.sin(angles), np.cos(angles))


def nearest_turn(joints: ArrayLike, reference: ArrayLike, limit: float = JOINT_LIMIT) -> Joints:
    """(..., 6) the same configuration, each joint shifted by whole turns to be nearest to `reference` within the limits [rad]."""
    joints, turn = np.asarray(joints, np.float64), 2 * np.pi
    moved = joints + turn * np.round((np.asarray(reference, np.float64) - joints) / turn)
    return np.where(np.abs(moved) > limit, moved - turn * np.sign(moved), moved)


def singularity(joints: ArrayLike, length_m: float = 0.4) -> float:
    """Distance from a singular configuration: the smallest singular value of the jacobian with lengths in units of `length_m`.

    0 at a singularity (arm stretched, wrist straight or shoulder above the flange); about 0.3 in a comfortable pose.
    """
    scaled = jacobian(joints) / np.array([length_m] * 3 + [1.0] * 3)[:, None]
    return float(np.linalg.svd(scaled, compute_uv=False)[-1])
