"""What moves: the arm of a rig with its camera, and what it has to keep clear of by itself, whatever the trajectory."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from koala3d.capture.model.arm import ArmModel
from koala3d.capture.model.built import BuiltArm
from koala3d.capture.model.parts import Part, Shape
from koala3d.capture.model.shapes.geometry import Vector
from koala3d.capture.model.shapes.solids import Solid
from koala3d.capture.model.turntable import TurntableDescription
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema
from koala3d.datasets.kinematics import Links

Array = NDArray[np.float64]
MAX_TOOL_SPEED = 0.25
"""Of the fastest point of the body unless the rig file says otherwise: the limit of reduced speed in ISO 10218-1 [m/s]."""
BRACKET_RADIUS = 0.025  # of the bracket, a capsule from the flange to the camera's projection centre [m]


class CameraCapsule(Schema):
    """All points within a radius of a line segment that moves with the camera."""

    name: str = Field(min_length=1, description="what a person calls this part of the camera")
    start: Vector = Field(description="one end of the segment in the camera's frame, z along the view [m]")
    end: Vector = Field(description="other end of the segment [m]")
    radius: float = Field(gt=0, le=1, description="radius [m]")


BODY = (
    CameraCapsule(name="lens", start=(0, 0, 0.016), end=(0, 0, -0.008), radius=0.017),
    CameraCapsule(name="camera", start=(0, 0, -0.008), end=(0, 0, -0.04), radius=0.021),
    CameraCapsule(name="plug", start=(0, 0, -0.05), end=(0, 0, -0.085), radius=0.015),
)
"""A cube of 29 mm with a 25 mm C-mount lens, whose projection centre lies in the lens, and a straight plug behind it."""


class Cable(Schema):
    """The camera's cable: how far joints may wind it up.

    The first joint winds it around the base and the last one around the wrist; those between bend it. Half a turn to either side
    takes no view away: whole turns bring each joint of each configuration to within half a turn of its rest.
    """

    max_turns: float = Field(
        default=0.5, gt=0, le=20, description="most turns by which each of its joints may wind it up, to either side of its rest"
    )
    joints: list[int] = Field(
        default=[], description="numbers of the joints that wind it, from 1; empty: the first and the last joint"
    )
    rest_deg: list[float] = Field(default=[], description="their angles where the cable is not wound; empty: zero")

    def turns(self, joints: ArrayLike) -> Array:
        """(...) turns by which the cable is wound at (..., n) joint angles [rad], by the joint that is farthest from its rest."""
        joints = np.asarray(joints, np.float64)
        winding = [number - 1 for number in self.joints] or [0, joints.shape[-1] - 1]
        rest = np.radians(self.rest_deg or np.zeros(len(winding)))
        return np.asarray(np.abs(joints[..., winding] - rest).max(-1) / (2 * np.pi))


PLATE_RADIUS = 0.02  # of the capsules that make up a plate on the flange [m]


@dataclass(frozen=True)
class Beside:
    """A camera that stands beside the arm, and the plate with a calibration target that the arm turns before it."""

    base_from_camera: Array  # (4, 4) nominal place of the camera [m]
    flange_from_plate: Array  # (4, 4) nominal place of the target's middle, with the axes of the board frame [m]
    plate: tuple[float, float]  # extent of the plate along these axes [m]

    @property
    def parts(self) -> list[tuple[Array, Array]]:
        """Ends in the frame of the flange of the axes of capsules, PLATE_RADIUS wide, that cover the plate."""
        half = np.maximum(np.array(self.plate) / 2 - PLATE_RADIUS, 0.0)
        rows = np.linspace(-half[1], half[1], max(int(np.ceil(self.plate[1] / (2 * PLATE_RADIUS))), 2))
        rotation, middle = self.flange_from_plate[:3, :3], self.flange_from_plate[:3, 3]
        return [(rotation @ [-half[0], y, 0.0] + middle, rotation @ [half[0], y, 0.0] + middle) for y in rows]


@dataclass(frozen=True)
class Fellow:
    """Another camera on the flange, whose body must not collide either."""

    name: str
    flange_from_camera: Array  # (4, 4) nominal mount [m]
    body: tuple[CameraCapsule, ...]


@dataclass(frozen=True)
class Carrier:
    """An arm and the camera that it carries; or the target that it carries, where the camera stands `beside` it."""

    arm: ArmModel
    flange_from_camera: Array  # (4, 4) nominal mount [m]; without meaning where the camera stands beside the arm
    body: tuple[CameraCapsule, ...] = BODY
    solids: tuple[Solid, ...] = ()  # what stands around the arm
    cable: Cable | None = None  # None: the cable is no limit
    turntable: TurntableDescription | None = None  # what turns the object; None: it stands
    beside: Beside | None = None  # None: the camera is on the flange
    fellows: tuple[Fellow, ...] = ()  # other cameras on the flange; views are planned without them
    max_tool_speed: float = MAX_TOOL_SPEED  # of the fastest point of arm, camera and plate [m/s]
    built: BuiltArm | None = None  # the arm with its own links; None: the nominal ones of the model

    def as_built(self, links: Links | None) -> Self:
        """The same with the calibrated links of an arm; None: with the nominal ones. Raises UsageError: of another model."""
        return replace(self, built=None if links is None else BuiltArm(self.arm, links))

    @property
    def links(self) -> Links:
        """The chain: the arm's own if it is known, else the nominal one."""
        return self.arm.links if self.built is None else self.built.links

    def forward(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) `base_from_flange` [m] of (..., n) joint angles [rad]."""
        return (self.built or self.arm).forward(joints)

    def frames(self, joints: ArrayLike) -> Array:
        """(..., n + 1, 4, 4) poses of base and links [m]."""
        return (self.built or self.arm).frames(joints)

    def inverse(self, base_from_flange: ArrayLike) -> Array:
        """(m, n) joint angles [rad, -pi..pi] of the branches that reach the (4, 4) pose, in or out of limits; m = 0: none."""
        return (self.built or self.arm).inverse(base_from_flange)

    @cached_property
    def shape(self) -> Shape:
        """The parts of the arm, the bracket, and the parts of the camera or of the plate; then those of other cameras."""
        last, mount = self.arm.count, self.flange_from_carried
        if self.beside is not None:
            holder = Part("bracket", BRACKET_RADIUS, last, np.zeros(3), mount[:3, 3], can_hide=False)
            plate = [Part("target", PLATE_RADIUS, last, *ends, neighbours=0, can_hide=False) for ends in self.beside.parts]
            return Shape((*self.arm.parts, holder, *plate))
        others = [part for one in self.fellows for part in _held(one.flange_from_camera, one.body, last, f"{one.name} ")]
        return Shape((*self.arm.parts, *_held(mount, self.body, last), *others))

    @property
    def flange_from_carried(self) -> Array:
        """(4, 4) nominal place on the flange [m] of the camera, or of the target's middle."""
        carried = self.flange_from_camera if self.beside is None else self.beside.flange_from_plate
        return np.asarray(carried, np.float64)

    def base_from_carried(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) nominal pose [m] of the camera, or of the target's middle, at (..., n) joint angles [rad]."""
        return np.asarray(self.forward(joints) @ self.flange_from_carried)

    def base_from_camera(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) nominal camera pose [m] at (..., n) joint angles [rad]."""
        return self.camera_at(self.forward(joints))

    def camera_at(self, base_from_flange: Array) -> Array:
        """(..., 4, 4) nominal camera pose [m] while the flange is at (..., 4, 4) poses [m]."""
        if self.beside is None:
            return np.asarray(base_from_flange @ self.flange_from_camera)
        return np.broadcast_to(self.beside.base_from_camera, base_from_flange.shape)

    def flange_for(self, base_from_camera: Array, base_from_middle: Array | None = None) -> Array:
        """(4, 4) flange pose [m] for a wanted camera pose [m].

        With the camera beside the arm, that pose is meant for a target whose middle lies at `base_from_middle`: the arm brings
        the target to where the camera sees it so. Raises UsageError where nothing says where the target lies.
        """
        if self.beside is None:
            return np.asarray(base_from_camera @ pose.inverse(self.flange_from_camera))
        if base_from_middle is None:
            remedy = "use a trajectory with 'target' and 'board', such as calibration"
            raise UsageError("the camera stands beside the arm and sees only a target on the flange", remedy=remedy)
        seen = pose.inverse(base_from_camera) @ base_from_middle
        return np.asarray(self.beside.base_from_camera @ seen @ pose.inverse(self.beside.flange_from_plate))

    def segments(self, joints: ArrayLike) -> Array:
        """(..., parts, 2, 3) ends of the axes of the parts of `shape` in the base [m], at (..., n) joint angles [rad]."""
        return self.shape.segments(self.frames(joints))

    def wound(self, joints: ArrayLike) -> Array:
        """(...) turns by which the cable is wound at (..., n) joint angles [rad]; 0 where the cable is no limit."""
        return np.zeros(np.shape(joints)[:-1]) if self.cable is None else self.cable.turns(joints)

    def forbidden(self, joints: ArrayLike) -> str:
        """Which limit of a joint or of the cable (n,) angles [rad] violate, in words; empty: none."""
        outside = self.arm.outside(joints)
        if outside or self.cable is None or bool(self.permitted(joints)):
            return outside
        turns, limit = float(self.cable.turns(joints)), self.cable.max_turns
        return f"the camera's cable would be wound up by {turns:.2f} turns, limit {limit:g} (robot.cable in the rig file)"

    def permitted(self, joints: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """(...) whether (..., n) angles are within the limits of joints, by a margin [rad], and of the cable."""
        inside = self.arm.inside(joints, margin)
        return inside if self.cable is None else inside & (self.cable.turns(joints) <= self.cable.max_turns)


def _held(mount: Array, body: tuple[CameraCapsule, ...], link: int, prefix: str = "") -> list[Part]:
    """The parts of a camera at a (4, 4) place on the flange [m], and of its bracket."""
    bracket = Part(f"{prefix}bracket", BRACKET_RADIUS, link, np.zeros(3), mount[:3, 3], can_hide=False)
    ends = [(mount[:3, :3] @ one.start + mount[:3, 3], mount[:3, :3] @ one.end + mount[:3, 3]) for one in body]
    camera = [
        Part(f"{prefix}{one.name}", one.radius, link, start, end, neighbours=0, can_hide=False)
        for one, (start, end) in zip(body, ends, strict=True)
    ]
    return [bracket, *camera]
