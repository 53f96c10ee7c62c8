"""The shape of the arm and its camera: a capsule along each part, that is all points within a radius of a line segment.

Lengths in metres, base frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.kinematics import link_frames

Array = NDArray[np.float64]

UPPER_ARM_OFFSET, FOREARM_OFFSET = 0.138, 0.007
"""Offset of the tubes from the Denavit-Hartenberg lines, along the axis of the shoulder joint [m]."""
CAMERA_BEHIND, CAMERA_BEFORE = 0.04, 0.02
"""Extent of the camera body behind the projection centre and of the lens in front of it [m]."""


@dataclass(frozen=True)
class Part:
    """One part of the arm: a capsule between two of the points of `_points`."""

    name: str
    radius: float
    start: str
    end: str
    avoids: tuple[str, ...] = ()  # names of the parts that it could collide with
    checks_table: bool = True  # whether it could reach the table or the ceiling
    checks_object: bool = True  # whether it could reach the object
    can_hide: bool = True  # whether it could be between the camera and the object


_LOWER = ("base", "shoulder", "upper arm", "elbow", "forearm")
PARTS = (
    Part("base", 0.075, "base", "shoulder", checks_table=False, checks_object=False),
    Part("shoulder", 0.06, "shoulder", "upper arm", checks_table=False),
    Part("upper arm", 0.06, "upper arm", "elbow"),
    Part("elbow", 0.055, "elbow", "forearm"),
    Part("forearm", 0.05, "forearm", "forearm end", ("base",)),
    Part("wrist 1", 0.045, "wrist 1", "wrist 2", _LOWER[:2]),
    Part("wrist 2", 0.045, "wrist 2", "wrist 3", _LOWER[:3]),
    Part("wrist 3", 0.04, "wrist 3", "flange", _LOWER[:4]),
    Part("bracket", 0.025, "flange", "camera", _LOWER, can_hide=False),
    Part("camera", 0.035, "camera back", "lens", _LOWER, can_hide=False),
)
INDEX = {part.name: index for index, part in enumerate(PARTS)}  # place of each part in `PARTS`, by name
RADII = np.array([part.radius for part in PARTS])


def segments(joints: ArrayLike, flange_from_camera: Array) -> Array:
    """(..., parts, 2, 3) both ends of the axis of each of `PARTS` [m], for (..., 6) joint angles [rad]."""
    points = _points(joints, flange_from_camera)
    return np.stack([np.stack([points[part.start], points[part.end]], axis=-2) for part in PARTS], axis=-3)


def _points(joints: ArrayLike, flange_from_camera: Array) -> dict[str, Array]:
    """(..., 3) points [m] by name, for (..., 6) joint angles [rad]."""
    frames = link_frames(joints)
    origin, side = frames[..., :3, 3], frames[..., 1, :3, 2]
    camera = frames[..., 6, :, :] @ flange_from_camera
    centre, axis = camera[..., :3, 3], camera[..., :3, 2]
    return {
        "base": origin[..., 0, :],
        "shoulder": origin[..., 1, :],
        "upper arm": origin[..., 1, :] + UPPER_ARM_OFFSET * side,
        "elbow": origin[..., 2, :] + UPPER_ARM_OFFSET * side,
        "forearm": origin[..., 2, :] + FOREARM_OFFSET * side,
        "forearm end": origin[..., 3, :] + FOREARM_OFFSET * side,
        "wrist 1": origin[..., 3, :],
        "wrist 2": origin[..., 4, :],
        "wrist 3": origin[..., 5, :],
        "flange": origin[..., 6, :],
        "camera": centre,
        "camera back": centre - CAMERA_BEHIND * axis,
        "lens": centre + CAMERA_BEFORE * axis,
    }
