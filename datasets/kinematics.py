"""Forward kinematics of a serial arm: joint angles [rad] to `base_from_flange` [m], and its derivative.

Base and flange are those of the arm's controller. The links are Denavit-Hartenberg frames, between two fixed transforms:

    previous_from_link = rot_z(theta) trans_z(d) trans_x(a) rot_x(alpha)
    base_from_flange = base @ link 1 @ ... @ link n @ tool

Every arm with n rotating joints in a row can be written so. A real arm differs from its maker's parameters by up to centimetres.
They are good enough for planning and for small corrections of measured poses, which come from the controller.
"""

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError

Array = NDArray[np.float64]
MAX_JOINTS = 16
MAX_LENGTH_M = 1e5
"""Frames of a calibrated arm may be this far away: on the common normal of two axes that are parallel to 10 microradians [m]."""


@dataclass(frozen=True)
class Links:
    """Denavit-Hartenberg parameters of n links: lengths (n,) [m], angles (n,) [rad]."""

    d: Array
    a: Array
    alpha: Array
    theta: Array
    """Added to the joint angles; zero for most nominal arms."""
    base: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the first joint's frame in the base [m]; the identity for most arms."""
    tool: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the flange in the last link's frame [m]; the identity for most arms."""

    @property
    def count(self) -> int:
        """Number of joints."""
        return len(self.d)

    @property
    def parameters(self) -> list[str]:
        """Names of the 4 n parameters, in the order of `link_motions`."""
        kinds = ("d of link {}", "a of link {}", "alpha of link {}", "offset of joint {}")
        return [kind.format(link + 1) for kind in kinds for link in range(self.count)]

    def with_errors(self, errors: ArrayLike) -> "Links":
        """An arm whose parameters differ by (4 n,) errors of d, a [m], alpha, theta [rad], in this order."""
        d, a, alpha, theta = np.split(np.asarray(errors, np.float64), 4)
        return Links(self.d + d, self.a + a, self.alpha + alpha, self.theta + theta, self.base, self.tool)

    def calibrated(self, rng: np.random.Generator, length_m: float, angle_rad: float) -> "Links":
        """An arm as built: every parameter has a normal error of the given standard deviation.

        Of three parallel joint axes in a row only the sum of the first two d matters, and it gets one error.
        """
        length, angle = rng.normal(0, length_m, (2, self.count)), rng.normal(0, angle_rad, (2, self.count))
        straight = np.abs(self.alpha) < 1e-9
        length[0, :-1][straight[:-1] & straight[1:]] = 0.0
        built = self.d + length[0], self.a + length[1], self.alpha + angle[0], self.theta + angle[1]
        return Links(*built, self.base, self.tool)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary; angles in degrees, as in the files of `configs/arms`."""
        angles = {"alpha_deg": np.degrees(self.alpha).tolist(), "theta_deg": np.degrees(self.theta).tolist()}
        return {"d": self.d.tolist(), "a": self.a.tolist(), **angles, "base": self.base.tolist(), "tool": self.tool.tolist()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Links from `to_json`'s dictionary; raises DatasetError where it is not valid."""
        try:
            d, a = (np.array(content[key], np.float64) for key in ("d", "a"))
            alpha = np.radians(np.array(content["alpha_deg"], np.float64))
            theta = np.radians(np.array(content.get("theta_deg") or np.zeros(len(d)), np.float64))
            if not (d.shape == a.shape == alpha.shape == theta.shape and 1 <= d.size <= MAX_JOINTS and d.ndim == 1):
                raise ValueError(f"d, a, alpha_deg and theta_deg must have the same 1 to {MAX_JOINTS} numbers")
            if not np.isfinite([d, a, alpha, theta]).all() or np.abs([d, a]).max() > MAX_LENGTH_M:
                raise ValueError(f"a number is not finite, or a length exceeds {MAX_LENGTH_M:g} m")
        except (TypeError, KeyError, ValueError, AttributeError) as error:
            raise DatasetError("links of the arm are not complete", where=where, why=str(error)) from None
        fixed = (pose.checked(content.get(key) or np.eye(4), where=f"{where}, {key}") for key in ("base", "tool"))
        return cls(d, a, alpha, theta, *fixed)


UR5E = Links(
    d=np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]),
    a=np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
    alpha=np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]),
    theta=np.zeros(6),
)
"""The UR5e by Universal Robots' "DH parameters for calculations of kinematics and dynamics"; files that name no arm mean it."""


def link_frames(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., n + 1, 4, 4) `base_from_link` of the first joint and of each link; the last is `base_from_flange` [m].

    Args:
        joints: (..., n) angles [rad].
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
    frames = [np.broadcast_to(links.base, (*theta.shape[:-1], 4, 4))]
    for index in range(links.count):
        frames.append(frames[-1] @ step[..., index, :, :])
    frames[-1] = frames[-1] @ links.tool
    return np.stack(frames, axis=-3)


def forward(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 4, 4) `base_from_flange` [m] of (..., n) joint angles [rad]."""
    return link_frames(joints, links)[..., -1, :, :]


def jacobian(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 6, n) Jacobian: flange velocity [m/s, rad/s] per joint speed [rad/s], linear rows first, in base axes."""
    frames = link_frames(joints, links)
    axes, origins = frames[..., :-1, :3, 2], frames[..., :-1, :3, 3]
    columns = np.concatenate([np.cross(axes, frames[..., -1:, :3, 3] - origins), axes], axis=-1)
    return np.swapaxes(columns, -1, -2)


def link_motions(joints: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 6, 4 n) motion of the flange, in flange axes, for small errors of the parameters: d, a, alpha, theta of all links.

    Translation first. Errors of d and theta move along and about the z axis before a link, those of a and alpha along and about
    the x axis after it.

    Args:
        joints: (..., n) angles [rad].
        links: the arm's parameters.
    """
    frames = link_frames(joints, links)
    flange = frames[..., -1, :, :]
    after = frames[..., 1:, :, :].copy()
    after[..., -1, :, :] = flange @ pose.inverse(links.tool)
    z, x = frames[..., :-1, :3, 2], after[..., :3, 0]
    place, end = flange[..., None, :3, 3], np.zeros_like(z)
    d, theta = np.concatenate([z, end], -1), np.concatenate([np.cross(z, place - frames[..., :-1, :3, 3]), z], -1)
    a, alpha = np.concatenate([x, end], -1), np.concatenate([np.cross(x, place - after[..., :3, 3]), x], -1)
    in_base = np.concatenate([d, a, alpha, theta], axis=-2)
    turn = flange[..., None, :3, :3]
    moved = [np.einsum("...ji,...j->...i", turn, in_base[..., part]) for part in (slice(0, 3), slice(3, 6))]
    return np.swapaxes(np.concatenate(moved, -1), -1, -2)


def corrected(base_from_flange: ArrayLike, joints: ArrayLike, errors: ArrayLike, links: Links = UR5E) -> Array:
    """(..., 4, 4) pose of the flange if the arm's parameters differ by their errors from those it reports its pose with.

    Only the change is computed from `links`. Nominal links make it wrong by the error times the angle between nominal and real
    axes, a thousandth of itself.

    Args:
        base_from_flange: (..., 4, 4) as reported [m].
        joints: (..., n) as reported [rad].
        errors: (4 n,) true minus reported d, a [m], alpha, theta [rad]; an error of theta is the offset of a joint.
        links: the arm's parameters.
    """
    joints = np.asarray(joints, np.float64)
    change = pose.inverse(forward(joints, links)) @ forward(joints, links.with_errors(errors))
    return np.asarray(base_from_flange, np.float64) @ change
