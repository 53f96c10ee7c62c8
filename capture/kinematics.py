"""Kinematics of the UR5e: joint angles [rad] to `base_from_flange` [m] and back.

Base and flange are those of the teach pendant. The links are Denavit-Hartenberg frames with the maker's parameters
(Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e):

    previous_from_link = rot_z(theta) trans_z(d) trans_x(a) rot_x(alpha)

A real arm differs from them, by up to centimetres: they serve planning. Measured poses come from the controller.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets import pose

Joints = NDArray[np.float64]

JOINT_LIMIT = 2 * np.pi
"""Each joint turns this far to either side [rad]."""
MAX_JOINT_SPEED = np.pi
"""Of every joint [rad/s]."""
REACH = 0.85
"""From the base axis to the wrist, nominal [m]."""


@dataclass(frozen=True)
class Links:
    """Denavit-Hartenberg parameters of the six links: lengths (6,) [m], angles (6,) [rad]."""

    d: NDArray[np.float64]
    a: NDArray[np.float64]
    alpha: NDArray[np.float64]
    theta: NDArray[np.float64]
    """Added to the joint angles; zero for the nominal arm."""

    def calibrated(self, rng: np.random.Generator, length_m: float, angle_rad: float) -> "Links":
        """An arm as built: each parameter off by a normal error of the given standard deviations.

        The second and third joint axes are parallel, so that only the sum of their d counts: it gets one error.
        """
        length, angle = rng.normal(0, length_m, (2, 6)), rng.normal(0, angle_rad, (2, 6))
        length[0, 1] = 0.0
        return Links(self.d + length[0], self.a + length[1], self.alpha + angle[0], self.theta + angle[1])


UR5E = Links(
    d=np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]),
    a=np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
    alpha=np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]),
    theta=np.zeros(6),
)


def link_frames(joints: ArrayLike, links: Links = UR5E) -> NDArray[np.float64]:
    """(..., 7, 4, 4) `base_from_link` of the base itself and of each link; the last is `base_from_flange` [m].

    Args:
        joints: (..., 6) angles [rad].
        links: the arm's parameters.
    """
    theta = np.asarray(joints, np.float64) + links.theta
    cos, sin = np.cos(theta), np.sin(theta)
    step = np.zeros((*theta.shape, 4, 4))
    step[..., 0, 0], step[..., 1, 0] = cos, sin
    step[..., 0, 1], step[..., 1, 1] = -sin * np.cos(links.alpha), cos * np.cos(links.alpha)
    step[..., 0, 2], step[..., 1, 2] = sin * np.sin(links.alpha), -cos * np.sin(links.alpha)
    step[..., 2, 1], step[..., 2, 2] = np.sin(links.alpha), np.cos(links.alpha)
    step[..., 0, 3], step[..., 1, 3], step[..., 2, 3] = links.a * cos, links.a * sin, links.d
    step[..., 3, 3] = 1.0
    frames = [np.broadcast_to(np.eye(4), (*theta.shape[:-1], 4, 4))]
    for index in range(6):
        frames.append(frames[-1] @ step[..., index, :, :])
    return np.stack(frames, axis=-3)


def forward(joints: ArrayLike, links: Links = UR5E) -> NDArray[np.float64]:
    """(..., 4, 4) `base_from_flange` [m] of (..., 6) joint angles [rad]."""
    return link_frames(joints, links)[..., -1, :, :]


def inverse(base_from_flange: ArrayLike) -> Joints:
    """(n, 6) joint angles [rad, -pi..pi] of every branch (up to 8) that reaches the pose with the nominal links; n = 0: none."""
    from ur_analytic_ik import ur5e

    target = np.ascontiguousarray(base_from_flange, np.float64)
    branches = np.array(ur5e.inverse_kinematics(target), np.float64).reshape(-1, 6)
    branches = branches[np.isfinite(branches).all(axis=1)]
    reached = forward(branches)  # next to a singularity the closed form may miss: keep what arrives
    distance, angle = pose.difference(reached, target)
    return wrap(branches[(distance < 1e-6) & (angle < 1e-6)])


def wrap(angles: ArrayLike) -> Joints:
    """Angles [rad] brought to -pi..pi."""
    angles = np.asarray(angles, np.float64)
    return np.arctan2(np.sin(angles), np.cos(angles))


def nearest_turn(joints: ArrayLike, reference: ArrayLike, limit: float = JOINT_LIMIT) -> Joints:
    """(..., 6) the same configuration with each joint turned by whole turns to be nearest to `reference`, inside the limits [rad]."""
    joints, turn = np.asarray(joints, np.float64), 2 * np.pi
    moved = joints + turn * np.round((np.asarray(reference, np.float64) - joints) / turn)
    return np.where(np.abs(moved) > limit, moved - turn * np.sign(moved), moved)


def jacobian(joints: ArrayLike, links: Links = UR5E) -> NDArray[np.float64]:
    """(6, 6) velocity of the flange [m/s over rad/s] for (6,) joint speeds [rad/s]: linear rows, then angular, in the base frame."""
    frames = link_frames(joints, links)
    axes, origins = frames[:6, :3, 2], frames[:6, :3, 3]
    return np.concatenate([np.cross(axes, frames[6, :3, 3] - origins), axes], axis=1).T


def singularity(joints: ArrayLike, length_m: float = 0.4) -> float:
    """Distance from a singular configuration: the smallest singular value of the jacobian with lengths in units of `length_m`.

    0 at a singularity (arm stretched, wrist straight or shoulder above the flange); about 0.3 in a comfortable pose.
    """
    scaled = jacobian(joints) / np.array([length_m] * 3 + [1.0] * 3)[:, None]
    return float(np.linalg.svd(scaled, compute_uv=False)[-1])
