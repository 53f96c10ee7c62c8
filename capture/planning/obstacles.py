"""How far the arm and its camera are from table, ceiling, object and themselves, with a capsule along each part.

A capsule is all that lies within a radius of a line segment. Lengths in metres, base frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.kinematics import link_frames

Array = NDArray[np.float64]

PARTS = ("base", "shoulder", "upper arm", "elbow", "forearm", "wrist 1", "wrist 2", "wrist 3", "bracket", "camera")
RADII = np.array([0.075, 0.06, 0.06, 0.055, 0.05, 0.045, 0.045, 0.04, 0.025, 0.035])
UPPER_ARM_OFFSET, FOREARM_OFFSET = 0.138, 0.007
"""Sideways, along the axis of the shoulder joint: the real tubes do not lie on the Denavit-Hartenberg lines [m]."""
CAMERA_BEHIND, CAMERA_BEFORE = 0.04, 0.02
"""Reach of the camera body behind its projection centre and of the lens before it [m]."""
SELF_PAIRS = tuple(
    (PARTS.index(moving), PARTS.index(still))
    for moving, others in (
        ("camera", ("base", "shoulder", "upper arm", "elbow", "forearm")),
        ("bracket", ("base", "shoulder", "upper arm", "elbow", "forearm")),
        ("wrist 3", ("base", "shoulder", "upper arm", "elbow")),
        ("wrist 2", ("base", "shoulder", "upper arm")),
        ("wrist 1", ("base", "shoulder")),
        ("forearm", ("base",)),
    )
    for still in others
)


def segments(joints: ArrayLike, flange_from_camera: Array) -> Array:
    """(..., parts, 2, 3) both ends of each part's axis [m], for (..., 6) joint angles [rad]."""
    frames = link_frames(joints)
    origin, side = frames[..., :3, 3], frames[..., 1, :3, 2]
    shoulder, elbow = origin[..., 1, :] + UPPER_ARM_OFFSET * side, origin[..., 2, :] + UPPER_ARM_OFFSET * side
    forearm = [origin[..., index, :] + FOREARM_OFFSET * side for index in (2, 3)]
    camera = frames[..., 6, :, :] @ flange_from_camera
    middle, axis = camera[..., :3, 3], camera[..., :3, 2]
    ends = [
        (origin[..., 0, :], origin[..., 1, :]),
        (origin[..., 1, :], shoulder),
        (shoulder, elbow),
        (elbow, forearm[0]),
        (forearm[0], forearm[1]),
        (origin[..., 3, :], origin[..., 4, :]),
        (origin[..., 4, :], origin[..., 5, :]),
        (origin[..., 5, :], origin[..., 6, :]),
        (origin[..., 6, :], middle),
        (middle - CAMERA_BEHIND * axis, middle + CAMERA_BEFORE * axis),
    ]
    return np.stack([np.stack(pair, axis=-2) for pair in ends], axis=-3)


def box_distance(ends: Array, corners: Array) -> Array:
    """(...) distance [m] of (..., 2, 3) segments from the boxes between (2, ..., 3) corners; 0 inside."""

    def distance(t: Array) -> Array:
        point = ends[..., 0, :] + t[..., None] * (ends[..., 1, :] - ends[..., 0, :])
        return np.linalg.norm(np.maximum(np.maximum(corners[0] - point, point - corners[1]), 0.0), axis=-1)

    return _least(distance, ends.shape[:-2])


def sight_distance(ends: Array, eye: Array, corners: Array) -> Array:
    """(...) distance [m] of (..., 2, 3) segments from all that lies between (..., 3) eyes and the box between (2, 3) corners.

    That is the box drawn towards the eye by every share of the way, and the distance from it is convex in that share.
    """
    reach = np.stack([corner - eye for corner in corners])
    return _least(lambda share: box_distance(ends, eye + share[..., None] * reach), ends.shape[:-2])


def _least(distance: Callable[[Array], Array], shape: tuple[int, ...]) -> Array:
    """Minima over 0 to 1 of convex functions: 14 steps of a ternary search leave 0.4 % of the interval."""
    low, high = np.zeros(shape), np.ones(shape)
    for _ in range(14):
        third = (high - low) / 3
        nearer = distance(low + third) <= distance(high - third)
        low, high = np.where(nearer, low, low + third), np.where(nearer, high - third, high)
    return distance((low + high) / 2)


def segment_distance(first: Array, second: Array) -> Array:
    """(...) distance [m] between (..., 2, 3) segments (Ericson, Real-Time Collision Detection, 2005, 5.1.9)."""
    u, v = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    w = first[..., 0, :] - second[..., 0, :]
    a, b, c = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    d, e = (u * w).sum(-1), (v * w).sum(-1)
    tiny = 1e-12
    determinant = a * c - b * b
    s = np.where(determinant > tiny, np.clip((b * e - c * d) / np.maximum(determinant, tiny), 0, 1), 0.0)
    t = np.clip((b * s + e) / np.maximum(c, tiny), 0, 1)
    s = np.clip((b * t - d) / np.maximum(a, tiny), 0, 1)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


@dataclass(frozen=True)
class Obstacles:
    """What the arm must keep clear of: (2, 3) corners of object and workspace, z of table and ceiling [m]; None: absent."""

    flange_from_camera: Array
    clearance_m: float
    table_z: float | None = None
    object_corners: Array | None = None
    workspace_corners: Array | None = None
    ceiling_z: float | None = None
    up: int = 1
    """1 where the base's z axis points up, -1 where the arm hangs."""

    @classmethod
    def of(cls, trajectory: Any, flange_from_camera: Array) -> "Obstacles":
        """Of a `Trajectory` and the nominal camera mount."""
        safety = trajectory.safety
        return cls(
            np.asarray(flange_from_camera, np.float64),
            safety.clearance_m,
            safety.table_z,
            None if trajectory.object is None else trajectory.object.corners,
            None if safety.workspace is None else safety.workspace.corners,
            safety.ceiling_z,
            trajectory.upwards,
        )

    def margins(self, joints: ArrayLike) -> dict[str, Array]:
        """Room left beyond the clearance [m] of (n, 6) joint angles: name of the pair to (n,); negative: too near."""
        ends = segments(joints, self.flange_from_camera)
        room: dict[str, Array] = {}
        for name, z, away in (("table", self.table_z, self.up), ("ceiling", self.ceiling_z, -self.up)):
            if z is not None:
                height = (away * (ends[..., 2:, :, 2] - z)).min(-1) - RADII[2:]
                room |= {f"{part} to {name}": height[..., i] for i, part in enumerate(PARTS[2:])}
        if self.object_corners is not None:
            gap = box_distance(ends[..., 1:, :, :], self.object_corners) - RADII[1:]
            room |= {f"{part} to object": gap[..., i] for i, part in enumerate(PARTS[1:])}
        first, second = np.array(SELF_PAIRS).T
        gap = segment_distance(ends[..., first, :, :], ends[..., second, :, :]) - RADII[first] - RADII[second]
        room |= {f"{PARTS[a]} to {PARTS[b]}": gap[..., i] for i, (a, b) in enumerate(SELF_PAIRS)}
        if self.workspace_corners is not None:
            camera = ends[..., -1, :, :].mean(-2)
            low, high = self.workspace_corners
            room["camera to the edge of the workspace"] = np.minimum(camera - low, high - camera).min(-1)
        return {name: value - self.clearance_m for name, value in room.items()}

    def margin(self, joints: ArrayLike) -> Array:
        """(n,) least room left beyond the clearance [m] of (n, 6) joint angles."""
        return np.min(list(self.margins(joints).values()), axis=0)

    def sights(self, joints: ArrayLike) -> dict[str, Array]:
        """Room between the arm and the camera's sight of the object [m] of (n, 6) joint angles: name of the part to (n,).

        Negative where the part may hide some of the object's box from the camera. Empty where there is no object.
        """
        if self.object_corners is None:
            return {}
        ends = segments(joints, self.flange_from_camera)
        arm = PARTS.index("bracket")  # which is behind the camera, as all after it
        eye = np.broadcast_to(ends[..., arm, None, 1, :], (*ends.shape[:-3], arm, 3))
        room = sight_distance(ends[..., :arm, :, :], eye, self.object_corners) - RADII[:arm]
        return {part: room[..., i] for i, part in enumerate(PARTS[:arm])}

    def sight(self, joints: ArrayLike) -> Array:
        """(n,) least room between the arm and the camera's sight of the object [m]; infinite where there is no object."""
        return np.min([np.full(len(np.asarray(joints)), np.inf), *self.sights(joints).values()], axis=0)

    def hiding(self, joints: ArrayLike) -> str:
        """The part of the arm that is most in the camera's sight of the object, of (6,) joint angles."""
        room = {part: float(value[0]) for part, value in self.sights(np.asarray(joints)[None]).items()}
        return min(room, key=room.__getitem__)

    def nearest(self, joints: ArrayLike) -> tuple[str, float]:
        """The pair that is nearest, and its room [m], of (6,) joint angles."""
        margins = {name: float(value[0]) for name, value in self.margins(np.asarray(joints)[None]).items()}
        name = min(margins, key=margins.__getitem__)
        return name, margins[name]
