"""How far the arm and its camera are from table, ceiling, object, other bodies, workspace and themselves.

Lengths in metres, base frame.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.parts import Shape
from koala3d.capture.model.shapes.distances import box_distance, segment_distance, sight_distance
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.turntable import required
from koala3d.capture.planning.swept import Sweep
from koala3d.datasets.kinematics import Links

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

    def as_built(self, links: Links | None) -> "Obstacles":
        """The same for an arm with its own links; see `Carrier.as_built`."""
        return replace(self, carrier=self.carrier.as_built(links))

    def flange_for(self, base_from_camera: Array) -> Array:
        """(4, 4) flange pose [m] for a wanted camera pose; see `Carrier.flange_for`."""
        return self.carrier.flange_for(base_from_camera, self.base_from_middle)

    @property
    def shape(self) -> Shape:
        """Its parts."""
        return self.carrier.shape

    def margins(self, joints: ArrayLike) -> dict[str, Array]:
        """Distances minus the clearance [m] for (m, n) joint angles: (m,) by the name of the pair. Negative: too close."""
        return _by_name(self.pairs, self.rooms(joints))

    def rooms(self, joints: ArrayLike) -> Array:
        """(m, k) distances minus the clearance [m] of the `pairs`, for (m, n) joint angles."""
        shape, ends = self.shape, self.carrier.segments(joints)
        on_table, free = self._checked
        found = [(away * (ends[..., on_table, :, :][..., 2] - z)).min(-1) - shape.radii[on_table] for _, z, away in self._planes]
        if self.object_corners is not None:
            found.append(box_distance(ends[..., free, :, :], self.object_corners) - shape.radii[free])
        found += [solid.distance(ends[..., free, :, :]) - shape.radii[free] for solid in self.carrier.solids]
        first, second = np.array(shape.pairs).T
        gap = segment_distance(ends[..., first, :, :], ends[..., second, :, :])
        found.append(gap - shape.radii[first] - shape.radii[second])
        if self.workspace_corners is not None:
            camera = ends[..., shape.index["bracket"], 1, :]
            low, high = self.workspace_corners
            found.append(np.minimum(camera - low, high - camera).min(-1, keepdims=True))
        return np.asarray(np.concatenate(found, axis=-1) - self.clearance_m)

    @cached_property
    def pairs(self) -> list[str]:
        """Names of the pairs that `rooms` is about; several capsules of one body may share a name."""
        (on_table, free), parts = self._checked, self.shape.parts
        found = [f"{parts[index].name} to {name}" for name, _, _ in self._planes for index in on_table]
        bodies = ["object"] * (self.object_corners is not None) + [solid.name for solid in self.carrier.solids]
        found += [f"{parts[index].name} to {name}" for name in bodies for index in free]
        found += [f"{parts[first].name} to {parts[second].name}" for first, second in self.shape.pairs]
        return found + ["camera to the edge of the workspace"] * (self.workspace_corners is not None)

    @property
    def _planes(self) -> list[tuple[str, float, int]]:
        """Name and z [m] of table and ceiling, and the sign of the direction in which the arm is away from them."""
        planes = (("table", self.table_z, self.up), ("ceiling", self.ceiling_z, -self.up))
        return [(name, z, away) for name, z, away in planes if z is not None]

    @property
    def _checked(self) -> tuple[list[int], list[int]]:
        """Places of the parts that could reach table or ceiling, and of those that could reach other bodies."""
        parts = list(enumerate(self.shape.parts))
        return [index for index, part in parts if part.checks_table], [index for index, part in parts if part.checks_object]

    @cached_property
    def sweep(self) -> Sweep:
        """What moves in each of the `pairs`. A distance changes no faster than this part moves."""
        (on_table, free), shape = self._checked, self.shape
        bodies = (self.object_corners is not None) + len(self.carrier.solids)
        alone = on_table * len(self._planes) + free * bodies
        edge = [] if self.workspace_corners is None else [shape.index["bracket"]]
        parts = [*alone, *(first for first, _ in shape.pairs), *edge]
        links = [*[0] * len(alone), *(shape.parts[second].link for _, second in shape.pairs), *[0] * len(edge)]
        return Sweep(self.carrier, np.array(parts), np.array(links))

    def margin(self, joints: ArrayLike) -> Array:
        """(m,) smallest of the `margins` [m] for (m, n) joint angles."""
        return np.asarray(self.rooms(joints).min(axis=-1))

    def free(self, joints: ArrayLike) -> NDArray[np.bool_]:
        """(m,) whether (m, n) joint angles keep clear of everything and within the limits of joints and cable."""
        return np.asarray((self.margin(joints) >= 0) & self.carrier.permitted(joints))

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
        return _by_name([shape.parts[index].name for index in hiding], distance - shape.radii[hiding])

    def sight(self, joints: ArrayLike) -> Array:
        """(m,) smallest of the `sights` [m]; infinite without an object."""
        return np.min([np.full(len(np.asarray(joints)), np.inf), *self.sights(joints).values()], axis=0)

    def hiding(self, joints: ArrayLike) -> str:
        """The part that hides the object most, at (n,) joint angles."""
        return _smallest(self.sights(np.asarray(joints)[None]))[0]

    def nearest(self, joints: ArrayLike) -> tuple[str, float]:
        """The closest pair and its margin [m], at (n,) joint angles."""
        return _smallest(self.margins(np.asarray(joints)[None]))


def _by_name(names: list[str], values: Array) -> dict[str, Array]:
    """The smallest of (..., k) values under each name, (...)."""
    found: dict[str, Array] = {}
    for place, name in enumerate(names):
        found[name] = np.minimum(found[name], values[..., place]) if name in found else values[..., place]
    return found


def _smallest(values: dict[str, Array]) -> tuple[str, float]:
    name = min(values, key=lambda label: float(values[label][0]))
    return name, float(values[name][0])
