"""How far the arm and its camera are from table, ceiling, object, workspace and themselves.

Lengths in metres, base frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.planning.arm_shape import INDEX, PARTS, RADII, segments
from capture.planning.distances import box_distance, segment_distance, sight_distance
from capture.trajectory import Trajectory

Array = NDArray[np.float64]


_TABLE = [index for index, part in enumerate(PARTS) if part.checks_table]
_OBJECT = [index for index, part in enumerate(PARTS) if part.checks_object]
_SIGHT = [index for index, part in enumerate(PARTS) if part.can_hide]
_SELF = [(INDEX[part.name], INDEX[other]) for part in reversed(PARTS) for other in part.avoids]


@dataclass(frozen=True)
class Obstacles:
    """What the arm must keep clear of: (2, 3) corners of object and workspace, z of table and ceiling [m]; None: absent."""

    flange_from_camera: Array
    clearance_m: float
    table_z: float | None = None
    object_corners: Array | None = None
    workspace_corners: Array | None = None
    ceiling_z: float | None = None
    up: int = 1  # 1 where the base's z axis points up, -1 where the arm hangs

    @classmethod
    def of(cls, trajectory: Trajectory, flange_from_camera: Array) -> "Obstacles":
        """Those of a trajectory, with the nominal camera mount."""
        safety, volume = trajectory.safety, trajectory.object
        return cls(
            np.asarray(flange_from_camera, np.float64),
            safety.clearance_m,
            table_z=safety.table_z,
            object_corners=None if volume is None else volume.corners,
            workspace_corners=None if safety.workspace is None else safety.workspace.corners,
            ceiling_z=safety.ceiling_z,
            up=trajectory.upwards,
        )

    def margins(self, joints: ArrayLike) -> dict[str, Array]:
        """Distances minus the clearance [m] for (n, 6) joint angles: (n,) by the name of the pair. Negative: too close."""
        ends = segments(joints, self.flange_from_camera)
        room: dict[str, Array] = {}
        for name, z, away in (("table", self.table_z, self.up), ("ceiling", self.ceiling_z, -self.up)):
            if z is not None:
                height = (away * (ends[..., _TABLE, :, :][..., 2] - z)).min(-1) - RADII[_TABLE]
                room |= _by_part(height, _TABLE, f" to {name}")
        if self.object_corners is not None:
            room |= _by_part(box_distance(ends[..., _OBJECT, :, :], self.object_corners) - RADII[_OBJECT], _OBJECT, " to object")
        first, second = np.array(_SELF).T
        gap = segment_distance(ends[..., first, :, :], ends[..., second, :, :]) - RADII[first] - RADII[second]
        room |= {f"{PARTS[a].name} to {PARTS[b].name}": gap[..., place] for place, (a, b) in enumerate(_SELF)}
        if self.workspace_corners is not None:
            camera = ends[..., INDEX["camera"], :, :].mean(-2)
            low, high = self.workspace_corners
            room["camera to the edge of the workspace"] = np.minimum(camera - low, high - camera).min(-1)
        return {name: value - self.clearance_m for name, value in room.items()}

    def margin(self, joints: ArrayLike) -> Array:
        """(n,) smallest of the `margins` [m] for (n, 6) joint angles."""
        return np.min(list(self.margins(joints).values()), axis=0)

    def sights(self, joints: ArrayLike) -> dict[str, Array]:
        """Distances between the arm and the camera's sight of the object [m] for (n, 6) joint angles: (n,) by part.

        Negative where the part may hide some of the object's box from the camera. Empty without an object.
        """
        if self.object_corners is None:
            return {}
        ends = segments(joints, self.flange_from_camera)
        eye = np.broadcast_to(ends[..., INDEX["bracket"], None, 1, :], (*ends.shape[:-3], len(_SIGHT), 3))
        return _by_part(sight_distance(ends[..., _SIGHT, :, :], eye, self.object_corners) - RADII[_SIGHT], _SIGHT)

    def sight(self, joints: ArrayLike) -> Array:
        """(n,) smallest of the `sights` [m]; infinite without an object."""
        return np.min([np.full(len(np.asarray(joints)), np.inf), *self.sights(joints).values()], axis=0)

    def hiding(self, joints: ArrayLike) -> str:
        """The part that hides the object most, at (6,) joint angles."""
        return _smallest(self.sights(np.asarray(joints)[None]))[0]

    def nearest(self, joints: ArrayLike) -> tuple[str, float]:
        """The closest pair and its margin [m], at (6,) joint angles."""
        return _smallest(self.margins(np.asarray(joints)[None]))


def _by_part(values: Array, indices: list[int], suffix: str = "") -> dict[str, Array]:
    """(..., parts) values of the parts with the given indices, as (...) values by label."""
    return {PARTS[index].name + suffix: values[..., place] for place, index in enumerate(indices)}


def _smallest(values: dict[str, Array]) -> tuple[str, float]:
    name = min(values, key=lambda label: float(values[label][0]))
    return name, float(values[name][0])
