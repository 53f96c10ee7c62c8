"""How far the arm and its camera are from table, ceiling, object, other bodies, workspace and themselves.

Lengths in metres, base frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.distances import box_distance, segment_distance, sight_distance
from koala3d.capture.model.parts import Shape
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.turntable import required

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Obstacles:
    """What the arm must keep clear of: (2, 3) corners of object and workspace, z of table and ceiling [m]; None: absent.

    Bodies that stand around the arm belong to the `carrier`.
    """

    carrier: Carrier
    clearance_m: float
    table_z: float | None = None
    object_corners: Array | None = None
    workspace_corners: Array | None = None
    ceiling_z: float | None = None
    up: int = 1  # 1 where the base's z axis points up, -1 where the arm hangs
    base_from_middle: Array | None = None  # (4, 4) where the views have the middle of the target [m]

    @classmethod
    def of(cls, trajectory: Trajectory, carrier: Carrier) -> "Obstacles":
        """Those of a trajectory, for an arm and its camera. An object that turns is as wide as all of its turn.

        Raises UsageError: the trajectory needs a turntable, and there is none.
        """
        safety, volume = trajectory.safety, trajectory.object
        corners = None if volume is None else volume.corners
        if trajectory.turns:
            table = required(carrier.turntable, trajectory.name)
            corners = None if corners is None else table.swept(corners)
        return cls(
            carrier,
            safety.clearance_m,
            table_z=safety.table_z,
            object_corners=corners,
            workspace_corners=None if safety.workspace is None else safety.workspace.corners,
            ceiling_z=safety.ceiling_z,
            up=trajectory.upwards,
            base_from_middle=trajectory.base_from_middle,
        )

    def flange_for(self, base_from_camera: Array) -> Array:
        """(4, 4) flange pose [m] for a wanted camera pose; see `Carrier.flange_for`."""
        return self.carrier.flange_for(base_from_camera, self.base_from_middle)

    @property
    def shape(self) -> Shape:
        """Its parts."""
        return self.carrier.shape

    def margins(self, joints: ArrayLike) -> dict[str, Array]:
        """Distances minus the clearance [m] for (m, n) joint angles: (m,) by the name of the pair. Negative: too close."""
        shape, ends = self.shape, self.carrier.segments(joints)
        on_table = [index for index, part in enumerate(shape.parts) if part.checks_table]
        free = [index for index, part in enumerate(shape.parts) if part.checks_object]
        room: dict[str, Array] = {}
        for name, z, away in (("table", self.table_z, self.up), ("ceiling", self.ceiling_z, -self.up)):
            if z is not None:
                height = (away * (ends[..., on_table, :, :][..., 2] - z)).min(-1) - shape.radii[on_table]
                room |= _by_part(shape, height, on_table, f" to {name}")
        if self.object_corners is not None:
            room |= _by_part(
                shape, box_distance(ends[..., free, :, :], self.object_corners) - shape.radii[free], free, " to object"
            )
        for solid in self.carrier.solids:
            room |= _by_part(shape, solid.distance(ends[..., free, :, :]) - shape.radii[free], free, f" to {solid.name}")
        first, second = np.array(shape.pairs).T
        gap = segment_distance(ends[..., first, :, :], ends[..., second, :, :]) - shape.radii[first] - shape.radii[second]
        names = [part.name for part in shape.parts]
        room |= {f"{names[a]} to {names[b]}": gap[..., place] for place, (a, b) in enumerate(shape.pairs)}
        if self.workspace_corners is not None:
            camera = ends[..., shape.index["bracket"], 1, :]
            low, high = self.workspace_corners
            room["camera to the edge of the workspace"] = np.minimum(camera - low, high - camera).min(-1)
        return {name: value - self.clearance_m for name, value in room.items()}

    def margin(self, joints: ArrayLike) -> Array:
        """(m,) smallest of the `margins` [m] for (m, n) joint angles."""
        return np.min(list(self.margins(joints).values()), axis=0)

    def free(self, joints: ArrayLike) -> NDArray[np.bool_]:
        """(m,) whether (m, n) joint angles keep clear of everything and within the limits of joints and cable."""
        return (self.margin(joints) >= 0) & self.carrier.permitted(joints)

    def sights(self, joints: ArrayLike) -> dict[str, Array]:
        """Distances between the arm and the camera's sight of the object [m] for (m, n) joint angles: (m,) by part.

        Negative where the part may hide some of the object's box from the camera. Empty without an object.
        """
        if self.object_corners is None:
            return {}
        shape, ends = self.shape, self.carrier.segments(joints)
        hiding = [index for index, part in enumerate(shape.parts) if part.can_hide]
        eye = np.broadcast_to(ends[..., shape.index["bracket"], None, 1, :], (*ends.shape[:-3], len(hiding), 3))
        distance = sight_distance(ends[..., hiding, :, :], eye, self.object_corners)
        return _by_part(shape, distance - shape.radii[hiding], hiding)

    def sight(self, joints: ArrayLike) -> Array:
        """(m,) smallest of the `sights` [m]; infinite without an object."""
        return np.min([np.full(len(np.asarray(joints)), np.inf), *self.sights(joints).values()], axis=0)

    def hiding(self, joints: ArrayLike) -> str:
        """The part that hides the object most, at (n,) joint angles."""
        return _smallest(self.sights(np.asarray(joints)[None]))[0]

    def nearest(self, joints: ArrayLike) -> tuple[str, float]:
        """The closest pair and its margin [m], at (n,) joint angles."""
        return _smallest(self.margins(np.asarray(joints)[None]))


def _by_part(shape: Shape, values: Array, indices: list[int], suffix: str = "") -> dict[str, Array]:
    """(..., parts) values of the parts with the given indices, as (...) values by label."""
    return {shape.parts[index].name + suffix: values[..., place] for place, index in enumerate(indices)}


def _smallest(values: dict[str, Array]) -> tuple[str, float]:
    name = min(values, key=lambda label: float(values[label][0]))
    return name, float(values[name][0])
