"""Patterns of camera poses for the `views` of a trajectory. A pattern gives the same poses on every call.

Each group knows the number of its views (`number`) and generates them in an order with short paths between them.
`up` is 1 where the base's z axis points up, and -1 where it points down (a hanging arm).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, StringConstraints, field_validator, model_validator

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.shapes.geometry import Vector
from koala3d.capture.model.turning import Turning
from koala3d.datasets import pose
from koala3d.datasets.core.schema import Schema
from koala3d.datasets.kinematics import MAX_JOINTS

Interval = tuple[float, float]
LampName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+$")]
"""Of a switched lamp; scenes are called by it."""
Angles = Annotated[list[float], Field(min_length=1, max_length=MAX_JOINTS)]


@dataclass(frozen=True)
class Viewpoint:
    """One desired view."""

    base_from_camera: NDArray[np.float64] | None = None  # (4, 4) desired camera pose [m]; None if joint angles are given instead
    rolls: tuple[float, ...] = (0.0,)  # equally good turns about the optical axis [rad]; the planner chooses one
    joints: NDArray[np.float64] | None = None  # (n,) angles [rad] of a view that is given by these
    turntable: float | None = None  # angle of the turntable [rad]; None in a trajectory without one
    lamps: tuple[str, ...] | None = None  # switched lamps that are on; None: they are left as they are
    name: str = ""  # names sort in the order of the trajectory
    split: str = ""  # "train", "test" or "calibration"

    def camera_pose(self, mount: Carrier) -> NDArray[np.float64]:
        """(4, 4) desired camera pose [m], before any roll; that of given joint angles follows from the nominal mount."""
        if self.base_from_camera is not None:
            return self.base_from_camera
        assert self.joints is not None  # a viewpoint has either
        return mount.base_from_camera(self.joints)


def spread(count: int, chosen: int) -> frozenset[int]:
    """`chosen` of `count` indices, evenly spaced, without the two ends."""
    return frozenset(int((index + 0.5) * count / chosen) for index in range(chosen))


class _Group(Schema):
    turntable: Turning | None = Field(default=None, description="angles of the turntable; null: zero, or there is none")
    lamps: list[list[LampName]] | None = Field(
        default=None,
        min_length=1,
        description="sets of the rig's switched lamps, under each of which each view is taken while the arm stands still; "
        "an empty set: all are off; null: they are left as they are",
    )
    use: Literal["train", "test"] | None = Field(
        default=None, description="what all views of the group are for; null: train, or what 'split' of the trajectory says"
    )

    @field_validator("lamps")
    @classmethod
    def _different(cls, lamps: list[list[str]] | None) -> list[list[str]] | None:
        for one in lamps or []:
            if len(set(one)) < len(one):
                raise ValueError(f"one lamp is listed twice: {', '.join(one)}")
        if lamps is not None and len({frozenset(one) for one in lamps}) < len(lamps):
            raise ValueError("two sets hold the same lamps")
        return lamps

    def under_lamps(self, views: list[Viewpoint]) -> list[Viewpoint]:
        """The views, each under each set of lamps in turn."""
        return views if self.lamps is None else [replace(view, lamps=tuple(one)) for view in views for one in self.lamps]


class _Rolled(_Group):
    roll_deg: list[float] = Field(default=[0.0], min_length=1, description="allowed turns about the view axis [degrees]")

    @property
    def _rolls(self) -> tuple[float, ...]:
        return tuple(np.radians(self.roll_deg))


class _Looking(_Rolled):
    target: Vector = Field(description="point that the camera looks at [m]")

    def _look(self, position: NDArray[np.float64], up: int) -> Viewpoint:
        return Viewpoint(pose.look_at(position, self.target, (0, 0, up)), self._rolls)


class _Counted(_Looking):
    count: int = Field(ge=1, le=10_000, description="number of views")

    @property
    def number(self) -> int:
        """Number of views."""
        return self.count


def _on_sphere(target: Vector, distance: float, azimuth_deg: float, elevation_deg: float, up: int) -> NDArray[np.float64]:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    direction = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), up * np.sin(elevation))
    return np.asarray(target) + distance * np.array(direction)


def _azimuths(interval: Interval, count: int) -> NDArray[np.float64]:
    low, high = interval
    return low + (np.arange(count) + 0.5) * (high - low) / count


class HemisphereViews(_Counted):
    """Rings around the target with an even density of views, in alternating directions."""

    kind: Literal["hemisphere"] = Field(description="pattern of the views")
    distance: float = Field(gt=0.05, le=2, description="camera to target [m]")
    elevation_deg: Interval = Field(default=(15.0, 70.0), description="elevation of the lowest and highest ring [degrees]")
    azimuth_deg: Interval = Field(default=(-180.0, 180.0), description="range around the vertical, 0 along base x [degrees]")
    rings: int = Field(default=4, ge=1, le=100, description="number of rings")

    @model_validator(mode="after")
    def _enough(self) -> Self:
        if self.count < self.rings:
            raise ValueError(f"{self.rings} rings need at least as many views, but count is {self.count}")
        if not -90 < self.elevation_deg[0] <= self.elevation_deg[1] < 90:
            raise ValueError(f"elevation_deg must rise inside -90..90, got {list(self.elevation_deg)}")
        return self

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views, ring by ring from below."""
        elevations = np.linspace(*self.elevation_deg, self.rings)
        share = np.cumsum(np.cos(np.radians(elevations)))
        last = np.maximum(np.round(self.count * share / share[-1]).astype(int), np.arange(1, self.rings + 1))
        last = np.minimum(last, self.count - np.arange(self.rings)[::-1])
        views = []
        for ring, (elevation, number) in enumerate(zip(elevations, np.diff(last, prepend=0), strict=True)):
            for azimuth in _azimuths(self.azimuth_deg, number)[:: -1 if ring % 2 else 1]:
                views.append(self._look(_on_sphere(self.target, self.distance, azimuth, elevation, up), up))
        return views


class OrbitViews(_Counted):
    """One ring around the target."""

    kind: Literal["orbit"] = Field(description="pattern of the views")
    distance: float = Field(gt=0.05, le=2, description="camera to target [m]")
    elevation_deg: float = Field(default=30.0, gt=-90, lt=90, description="elevation of the ring above the horizon [degrees]")
    azimuth_deg: Interval = Field(default=(-180.0, 180.0), description="range around the vertical, 0 along base x [degrees]")

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views in order of azimuth."""
        azimuths = _azimuths(self.azimuth_deg, self.count)
        return [self._look(_on_sphere(self.target, self.distance, azimuth, self.elevation_deg, up), up) for azimuth in azimuths]


def _steps(count: int, extent: float) -> NDArray[np.float64]:
    return np.linspace(-0.5, 0.5, count) * extent if count > 1 else np.zeros(1)


class GridViews(_Looking):
    """Camera positions on a horizontal grid, all looking at the target."""

    kind: Literal["grid"] = Field(description="pattern of the views")
    centre: Vector = Field(description="middle of the grid [m]")
    size: Interval = Field(description="extent along x and y [m]")
    columns: int = Field(ge=1, le=1000, description="positions along x")
    rows: int = Field(ge=1, le=1000, description="positions along y")

    @property
    def number(self) -> int:
        """Number of views."""
        return self.columns * self.rows

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views, row by row, in alternating directions."""
        xs, ys = _steps(self.columns, self.size[0]), _steps(self.rows, self.size[1])
        return [self._look(np.add(self.centre, (x, y, 0.0)), up) for row, y in enumerate(ys) for x in xs[:: -1 if row % 2 else 1]]


class TiltedViews(_Counted):
    """Calibration views of a horizontal board: an even mixture of tilts, turns about the view axis, distances and shifts."""

    kind: Literal["tilted"] = Field(description="pattern of the views")
    distance: Interval = Field(default=(0.3, 0.5), description="shortest and longest distance to the target [m]")
    tilt_deg: Interval = Field(default=(0.0, 40.0), description="smallest and largest angle between view and vertical [degrees]")
    turn_deg: Interval = Field(default=(-180.0, 180.0), description="range of the turn about the view axis [degrees]")
    azimuth_deg: Interval = Field(default=(-180.0, 180.0), description="range of the camera's direction [degrees]")
    shift: Interval = Field(default=(0.0, 0.0), description="largest shift of the target along x and y [m]")

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views in order of azimuth; the other quantities follow a low-discrepancy sequence (Roberts 2018, R_5)."""
        root = 1.1673039782614187  # of x^6 = x + 1: the five-dimensional counterpart of the golden ratio
        views = []
        for index in range(self.count):
            u = (0.5 + (index + 1) * root ** -np.arange(1.0, 6.0)) % 1.0
            side = self.azimuth_deg[0] + (index + 0.5) / self.count * (self.azimuth_deg[1] - self.azimuth_deg[0])
            tilt = np.interp(np.sqrt(u[0]), (0, 1), self.tilt_deg)
            target = np.asarray(self.target) + np.append((2 * u[3:5] - 1) * self.shift, 0.0)
            position = _on_sphere(tuple(target), np.interp(u[1], (0, 1), self.distance), side, 90 - max(tilt, 0.1), up)
            turn = pose.from_rotation_vector([0, 0, np.radians(np.interp(u[2], (0, 1), self.turn_deg))])
            views.append(Viewpoint(pose.look_at(position, target, (0, 0, up)) @ turn, self._rolls))
        return views


class CameraPose(Schema):
    """One camera pose, oriented by a point to look at or by a quaternion."""

    position: Vector = Field(description="camera position [m]")
    look_at: Vector | None = Field(default=None, description="point in the middle of the image [m]")
    quaternion_wxyz: tuple[float, float, float, float] | None = Field(default=None, description="orientation, w x y z")

    @model_validator(mode="after")
    def _one_orientation(self) -> Self:
        if (self.look_at is None) == (self.quaternion_wxyz is None):
            raise ValueError("give either look_at or quaternion_wxyz")
        if self.look_at == self.position:
            raise ValueError("position and look_at coincide")
        if self.quaternion_wxyz is not None and np.linalg.norm(self.quaternion_wxyz) < 1e-6:
            raise ValueError("quaternion_wxyz is zero")
        return self

    def matrix(self, up: int = 1) -> NDArray[np.float64]:
        """(4, 4) `base_from_camera` [m]."""
        if self.quaternion_wxyz is not None:
            return pose.from_quaternion(self.quaternion_wxyz, self.position)
        assert self.look_at is not None  # by `_one_orientation`
        return pose.look_at(self.position, self.look_at, (0, 0, up))


class PoseViews(_Rolled):
    """A list of camera poses."""

    kind: Literal["poses"] = Field(description="pattern of the views")
    poses: list[CameraPose] = Field(min_length=1, description="the camera poses")

    @property
    def number(self) -> int:
        """Number of views."""
        return len(self.poses)

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views as listed."""
        return [Viewpoint(view.matrix(up), self._rolls) for view in self.poses]


class JointViews(_Group):
    """A list of joint angles."""

    kind: Literal["joints"] = Field(description="pattern of the views")
    joints_deg: list[Angles] = Field(min_length=1, description="angles of all joints for each view [degrees]")

    @property
    def number(self) -> int:
        """Number of views."""
        return len(self.joints_deg)

    def generate(self, up: int = 1) -> list[Viewpoint]:
        """The views as listed, for either `up`; their camera poses follow from the rig."""
        return [Viewpoint(joints=np.radians(joints)) for joints in self.joints_deg]
