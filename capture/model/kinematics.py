"""Joint angles [rad] and poses [m]: what `datasets.kinematics` has, and what arms of any kind share.

Without `links` the functions mean the UR5e. `capture.model.arm` has the other arms, and inverse kinematics.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.kinematics import UR5E as UR5E
from koala3d.datasets.kinematics import Links as Links
from koala3d.datasets.kinematics import forward as forward
from koala3d.datasets.kinematics import jacobian as jacobian
from koala3d.datasets.kinematics import link_frames as link_frames

Joints = NDArray[np.float64]

JOINT_LIMIT = 2 * np.pi  # range of each joint of Universal Robots' arms to either side [rad]


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


def nearest_turn(
    joints: ArrayLike, reference: ArrayLike, lower: ArrayLike = -JOINT_LIMIT, upper: ArrayLike = JOINT_LIMIT
) -> Joints:
    """(..., n) the same configuration, each joint shifted by whole turns to be nearest to `reference`.

    An angle beyond a limit [rad] is brought back by one turn; where limits are less than a turn apart, it may still be outside.
    """
    joints, turn = np.asarray(joints, np.float64), 2 * np.pi
    moved = joints + turn * np.round((np.asarray(reference, np.float64) - joints) / turn)
    return np.where(moved > upper, moved - turn, np.where(moved < lower, moved + turn, moved))


def singularity(joints: ArrayLike, links: Links = UR5E, length_m: float = 0.4) -> NDArray[np.float64]:
    """(...) distance of (..., n) angles from a singular configuration.

    It is the smallest singular value of the jacobian with lengths in units of `length_m`: 0 at a singularity (arm stretched,
    wrist straight or shoulder above the flange); about 0.3 in a comfortable pose.
    """
    scaled = jacobian(joints, links) / np.array([length_m] * 3 + [1.0] * 3)[:, None]
    return np.asarray(np.linalg.svd(scaled, compute_uv=False)[..., -1])
