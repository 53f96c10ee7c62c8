"""Forward kinematics of a serial arm: joint angles [rad] to `base_from_flange` [m], and its derivative.

Base and flange are those of the teach pendant. The links are Denavit-Hartenberg frames with the manufacturer's parameters
(Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5e):

    previous_from_link = rot_z(theta) trans_z(d) trans_x(a) rot_x(alpha)

A real arm differs from them by up to centimetres. They are good enough for planning and for small corrections of measured poses,
which come from the controller.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Links:
    """Denavit-Hartenberg parameters of the six links: lengths (6,) [m], angles (6,) [rad]."""

    d: Array
    a: Array
    alpha: Array
    theta: Array
    """Added to the joint angles; zero for the nominal arm."""

    def calibrated(self, rng: np.random.Generator, length_m: float, angle_rad: float) -> "Links":
        """An arm as built: every parameter has a normal error of the given standard deviation.

        The second and third joint axes are parallel, so only the sum of their d matters, and it gets one error.
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


def link_frames(joints: ArrayLike, links: Links = UR5E) -> Array:
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


def forward(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 4, 4) `base_from_flange` [m] of (..., 6) joint angles [rad]."""
    return link_frames(joints, links)[..., -1, :, :]


def jacobian(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 6, 6) Jacobian: flange velocity [m/s, rad/s] per joint speed [rad/s], linear rows first, in base axes."""
    frames = link_frames(joints, links)
    axes, origins = frames[..., :6, :3, 2], frames[..., :6, :3, 3]
    columns = np.concatenate([np.cross(axes, frames[..., 6:, :3, 3] - origins), axes], axis=-1)
    return np.swapaxes(columns, -1, -2)


def flange_jacobian(joints: ArrayLike, links: Links = UR5E) -> Array:
    """`jacobian` with the velocity in flange axes."""
    in_base, flange_from_base = jacobian(joints, links), np.swapaxes(forward(joints, links)[..., :3, :3], -1, -2)
    return np.concatenate([flange_from_base @ in_base[..., :3, :], flange_from_base @ in_base[..., 3:, :]], axis=-2)


def turned(base_from_flange: ArrayLike, joints: ArrayLike, offsets: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 4, 4) pose of the flange if each joint angle differs by its offset from the one the arm reported.

    Only the change is computed from `links`. Nominal links make it wrong by the offset times the angle between nominal and real
    axes, a thousandth of itself.

    Args:
        base_from_flange: (..., 4, 4) as reported [m].
        joints: (..., 6) as reported [rad].
        offsets: (6,) true angle minus reported angle [rad].
        links: the arm's parameters.
    """
    joints = np.asarray(joints, np.float64)
    change = pose.inverse(forward(joints, links)) @ forward(joints + np.asarray(offsets, np.float64), links)
    return np.asarray(base_from_flange, np.float64) @ change
