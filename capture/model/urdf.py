"""Reads the chain of an arm from a URDF file, and writes it with Denavit-Hartenberg parameters.

A URDF puts a frame at each joint and turns it about any axis. The Denavit-Hartenberg frames of the same arm lie on the common
normals of its joint axes (Craig, "Introduction to Robotics", 3.4); two fixed transforms take up what is left at both ends.
Shapes in the file are not read: `ArmModel.capsules` has the arm's.
"""

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
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

    Raises UsageError: the file cannot be read, a link is missing, the two are not connected, or a joint neither rotates nor is
    fixed.
    """
    joints = _joints_by_child(path)
    steps: list[ElementTree.Element] = []
    link = flange
    while link != base:
        if link not in joints or len(steps) > len(joints):
            why = f"no joint leads from '{base}' to '{link}'"
            raise UsageError("the two links are not connected", where=path, why=why, remedy="check urdf.base and urdf.flange")
        steps.insert(0, joints[link])
        link = _attribute(joints[link], "parent", "link", path)
    place, frames, axes, moving = np.eye(4), [np.eye(4)], [], []
    for joint in steps:
        place = place @ _origin(joint, path)
        kind = joint.get("type")
        if kind in ("revolute", "continuous"):
            frames.append(place)
            axes.append(place[:3, :3] @ _axis(joint, path))
            moving.append(joint)
        elif kind != "fixed":
            why = f"joint '{joint.get('name')}' is {kind}"
            raise UsageError("only arms whose joints rotate are supported", where=path, why=why)
    if not moving:
        raise UsageError("no joint moves between the two links", where=path, remedy="check urdf.base and urdf.flange")
    links = from_axes(np.array([frame[:3, 3] for frame in frames[1:]]), np.array(axes), place)
    own = pose.inverse(link_frames(np.zeros(len(moving)), links)) @ np.stack([np.eye(4), *frames[1:]])
    limits = np.array([_limits(joint, path) for joint in moving])
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


def _joints_by_child(path: Path) -> dict[str, ElementTree.Element]:
    try:
        root = ElementTree.fromstring(files.read_regular(path, MAX_BYTES))
    except ElementTree.ParseError as error:
        raise UsageError("is not a URDF file", where=path, why=str(error)) from None
    if root.tag != "robot":
        raise UsageError("is not a URDF file", where=path, why=f"its root is <{root.tag}>, not <robot>")
    return {_attribute(joint, "child", "link", path): joint for joint in root.iter("joint") if joint.find("child") is not None}


def _attribute(joint: ElementTree.Element, tag: str, name: str, path: Path) -> str:
    element = joint.find(tag)
    found = None if element is None else element.get(name)
    if not found:
        raise UsageError(f"joint '{joint.get('name')}' has no {tag}", where=path)
    return found


def _numbers(text: str, count: int, joint: ElementTree.Element, path: Path) -> Array:
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise UsageError(f"joint '{joint.get('name')}' needs {count} finite numbers", where=path, why=f"got '{text[:60]}'")
    return numbers


def _origin(joint: ElementTree.Element, path: Path) -> Array:
    """(4, 4) parent_from_joint; `rpy` turns about the fixed x, then y, then z."""
    element = joint.find("origin")
    place, angles = ("0 0 0", "0 0 0") if element is None else (element.get("xyz", "0 0 0"), element.get("rpy", "0 0 0"))
    roll, pitch, yaw = _numbers(angles, 3, joint, path)
    turns = [pose.from_rotation_vector(vector)[:3, :3] for vector in ([0, 0, yaw], [0, pitch, 0], [roll, 0, 0])]
    return pose.rigid(turns[0] @ turns[1] @ turns[2], _numbers(place, 3, joint, path))


def _axis(joint: ElementTree.Element, path: Path) -> Array:
    element = joint.find("axis")
    axis = _numbers("1 0 0" if element is None else element.get("xyz", "1 0 0"), 3, joint, path)
    if np.linalg.norm(axis) < 1e-6:
        raise UsageError(f"joint '{joint.get('name')}' has no axis", where=path)
    return np.asarray(axis / np.linalg.norm(axis))


def _limits(joint: ElementTree.Element, path: Path) -> tuple[float, float, float]:
    element = joint.find("limit")
    limit = {} if element is None else dict(element.items())
    speed = float(_numbers(limit["velocity"], 1, joint, path)[0]) if "velocity" in limit else np.inf
    if joint.get("type") == "continuous":
        return -np.inf, np.inf, speed
    low, high = (float(_numbers(limit.get(name, "0"), 1, joint, path)[0]) for name in ("lower", "upper"))
    return low, high, speed
