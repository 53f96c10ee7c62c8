"""Reads the chain of an arm from a URDF file, and writes it with Denavit-Hartenberg parameters.

A URDF puts a frame at each joint and turns it about any axis. The Denavit-Hartenberg frames of the same arm lie on the common
normals of its joint axes (Craig, "Introduction to Robotics", 3.4); two fixed transforms take up what is left at both ends.
Shapes in the file are not read: `ArmModel.capsules` has the arm's.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.bags.joints import TURNING, Joint, joints_by_child
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import Links, link_frames

Array = NDArray[np.float64]
PARALLEL = 1e-9  # sine of the angle between two axes that count as parallel
MAX_BYTES = 2**24


@dataclass(frozen=True)
class Chain:
    """The rotating joints from one link of a URDF to another."""

    links: Links
    lower: Array  # (n,) [rad]; infinite for a continuous joint
    upper: Array  # (n,) [rad]
    speed: Array  # (n,) [rad/s]; infinite where the file says nothing
    own_frames: Array
    """(n + 1, 4, 4) pose of the URDF's frames in those of `links` [m]: the base in the first joint's, then each moving link."""


def read_chain(path: Path, base: str, flange: str) -> Chain:
    """The chain between two links of a URDF file, by their names.

    Raises:
        UsageError: the file is missing, a link is, the two are not connected, or a joint neither rotates nor is fixed.
        DatasetError: it is no URDF, or a joint on the way cannot be read.
    """
    joints = joints_by_child(files.read_text(path, MAX_BYTES), where=path)
    steps: list[Joint] = []
    link = flange
    while link != base:
        if link not in joints or len(steps) > len(joints):
            why = f"no joint leads from '{base}' to '{link}'"
            raise UsageError("the two links are not connected", where=path, why=why, remedy="check urdf.base and urdf.flange")
        steps.insert(0, joints[link])
        link = joints[link].parent
    place, frames, axes, moving = np.eye(4), [np.eye(4)], [], []
    for joint in steps:
        place = place @ joint.origin
        if joint.kind in TURNING:
            frames.append(place)
            axes.append(place[:3, :3] @ joint.axis)
            moving.append(joint)
        elif joint.kind != "fixed":
            why = f"joint '{joint.name}' is {joint.kind}"
            raise UsageError("only arms whose joints rotate are supported", where=path, why=why)
    if not moving:
        raise UsageError("no joint moves between the two links", where=path, remedy="check urdf.base and urdf.flange")
    links = from_axes(np.array([frame[:3, 3] for frame in frames[1:]]), np.array(axes), place)
    own = pose.inverse(link_frames(np.zeros(len(moving)), links)) @ np.stack([np.eye(4), *frames[1:]])
    limits = np.array([joint.limits for joint in moving])
    return Chain(links, limits[:, 0], limits[:, 1], limits[:, 2], own)


def from_axes(points: Array, axes: Array, base_from_flange: Array) -> Links:
    """Denavit-Hartenberg parameters of an arm by its joint axes at zero angles.

    Args:
        points: (n, 3) a point on each axis in the base [m].
        axes: (n, 3) unit directions in the base; a joint turns about its own by the right-hand rule.
        base_from_flange: (4, 4) at zero angles [m].
    """
    count = len(points)
    first = _frame(points[0], axes[0], _across(axes[0]))
    parameters, before = np.zeros((4, count)), first
    for index in range(count - 1):
        origin, along = _common_normal(before, points[index], axes[index], points[index + 1], axes[index + 1])
        after = _frame(origin, axes[index + 1], along)
        x, z = before[:3, 0], before[:3, 2]
        parameters[0, index] = (origin - before[:3, 3]) @ z
        parameters[1, index] = (origin - before[:3, 3]) @ along
        parameters[2, index] = np.arctan2(np.cross(z, axes[index + 1]) @ along, z @ axes[index + 1])
        parameters[3, index] = np.arctan2(np.cross(x, along) @ z, x @ along)
        before = after
    d, a, alpha, theta = parameters
    return Links(d, a, alpha, theta, first, pose.inverse(before) @ base_from_flange)


def _common_normal(before: Array, point: Array, axis: Array, other_point: Array, other_axis: Array) -> tuple[Array, Array]:
    """Foot of the common normal of two axes on the second one, and its direction from the first to the second."""
    across, between = np.cross(axis, other_axis), other_point - point
    sine = float(np.linalg.norm(across))
    if sine < PARALLEL:  # every normal is common: the one through the frame before
        start = before[:3, 3]
        foot = other_point + ((start - other_point) @ other_axis) * other_axis
        away = foot - start
        along = away - (away @ axis) * axis
        length = float(np.linalg.norm(along))
        return foot, along / length if length > PARALLEL else before[:3, 0]
    along = across / sine
    foot = other_point + other_axis * _share(between, axis, other_axis)
    return foot, along if between @ along >= 0 else -along


def _share(between: Array, axis: Array, other_axis: Array) -> float:
    """How far along the second axis its point nearest to the first axis is [m]."""
    cosine = float(axis @ other_axis)
    return float((cosine * (between @ axis) - between @ other_axis) / (1 - cosine**2))


def _frame(origin: Array, z: Array, x: Array) -> Array:
    return pose.rigid(np.column_stack([x, np.cross(z, x), z]), origin)


def _across(axis: Array) -> Array:
    """A unit vector across an axis: x where it is, or the nearest other axis of the base."""
    for other in np.eye(3):
        across = other - (other @ axis) * axis
        if np.linalg.norm(across) > 0.5:
            return np.asarray(across / np.linalg.norm(across))
    raise AssertionError("one of three axes is across")  # two of them at least
