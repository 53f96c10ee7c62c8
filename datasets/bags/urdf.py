"""Frames of an arm from its joint angles and its URDF: `/joint_states` with `/robot_description`, or a file beside the bag."""

from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.bags.frames import Edge, Tree, edge_of
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError

TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)
"""Kinds of joints that move."""


def tree_of(text: str, states: Iterable[tuple[int, Any]], *, where: object) -> Tree:
    """Frames of the URDF `text` over (time stamp [ns], JointState) pairs; joints that no message names stand still at zero.

    Raises DatasetError if the URDF cannot be read.
    """
    angles: dict[str, list[tuple[int, float]]] = {}
    for stamp_ns, state in states:
        for name, value in zip(state.name, state.position, strict=False):
            angles.setdefault(name, []).append((stamp_ns, float(value)))
    try:
        joints = files.parse_xml(text, where=where).findall("joint")
        return {str(_link(joint, "child")): _edge(joint, angles.get(joint.get("name", ""), [])) for joint in joints}
    except (ValueError, AttributeError) as error:
        raise DatasetError("URDF cannot be read", where=where, why=str(error), remedy="expand it with xacro") from None


def _link(joint: ElementTree.Element, which: str) -> str:
    """The link that a joint names as its parent or child. Raises ValueError if it names none."""
    found = joint.find(which)
    if found is None or not found.get("link"):
        raise ValueError(f"joint {joint.get('name')} has no {which}")
    return str(found.get("link"))


def _numbers(element: ElementTree.Element | None, key: str, otherwise: str) -> NDArray[np.float64]:
    """(3,) numbers of an attribute. Raises ValueError for anything else."""
    text = otherwise if element is None else element.get(key, otherwise)
    return np.array(text.split(), np.float64).reshape(3)


def _edge(joint: ElementTree.Element, angles: list[tuple[int, float]]) -> Edge:
    """The child of a joint over time: a fixed origin, then a turn about the axis or a way along it."""
    origin, kind = joint.find("origin"), joint.get("type", "fixed")
    turn = Rotation.from_euler("xyz", _numbers(origin, "rpy", "0 0 0")).as_matrix()
    fixed = pose.rigid(turn, _numbers(origin, "xyz", "0 0 0"))
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0")
    if kind not in (*TURNING, *SLIDING) or not angles:
        return edge_of(_link(joint, "parent"), [(0, fixed)])
    times, values = (np.array(part) for part in zip(*sorted(dict(angles).items()), strict=True))
    along = values[:, None] * axis / max(float(np.linalg.norm(axis)), 1e-12)
    if kind in TURNING:
        moved = pose.rigid(Rotation.from_rotvec(along).as_matrix(), np.zeros(3))
    else:
        moved = pose.rigid(np.eye(3), along)
    return Edge(_link(joint, "parent"), times.astype(np.int64), fixed @ moved)
