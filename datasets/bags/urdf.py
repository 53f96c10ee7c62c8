"""Frames of an arm from its joint angles and its URDF: `/joint_states` with `/robot_description`, or a file beside the bag."""

from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.bags.frames import Edge, Tree, edge_of
from koala3d.datasets.bags.joints import SLIDING, TURNING, Joint, joints_by_child
from koala3d.datasets.core.errors import DatasetError

FURTHEST = 1e9
"""Larger positions are no numbers that a joint can have [rad or m]."""


def tree_of(text: str, states: Iterable[tuple[int, Any]], *, where: object) -> Tree:
    """Frames of the URDF `text` over (time stamp [ns], JointState) pairs; joints that no message names stand still at zero.

    Raises DatasetError if the URDF cannot be read, or no position of a joint is a number.
    """
    angles: dict[str, list[tuple[int, float]]] = {}
    for stamp_ns, state in states:
        for name, value in zip(state.name, state.position, strict=False):
            angles.setdefault(name, []).append((stamp_ns, float(value)))
    angles = {name: [one for one in found if abs(one[1]) < FURTHEST] or _senseless(name, where) for name, found in angles.items()}
    joints = joints_by_child(text, where=where)
    return {link: _edge(joint, angles.get(joint.name, [])) for link, joint in joints.items()}


def _senseless(name: str, where: object) -> NoReturn:
    raise DatasetError(f"no position of joint '{name}' is a number", where=where)


def _edge(joint: Joint, angles: list[tuple[int, float]]) -> Edge:
    """The child of a joint over time: a fixed origin, then a turn about the axis or a way along it."""
    if joint.kind not in (*TURNING, *SLIDING) or not angles:
        return edge_of(joint.parent, [(0, joint.origin)])
    times, values = (np.array(part) for part in zip(*sorted(dict(angles).items()), strict=True))
    along = values[:, None] * joint.axis
    if joint.kind in TURNING:
        moved = pose.rigid(Rotation.from_rotvec(along).as_matrix(), np.zeros(3))
    else:
        moved = pose.rigid(np.eye(3), along)
    return Edge(joint.parent, times.astype(np.int64), joint.origin @ moved)
