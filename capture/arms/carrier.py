"""What moves: the arm of a rig with its camera, and what it has to keep clear of by itself, whatever the trajectory."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from capture.arms.model import DEFAULT, ArmModel, load_arm
from capture.arms.parts import Part, Shape
from capture.geometry import Vector
from capture.shapes.solids import Solid
from capture.turntables.description import TurntableDescription
from datasets.core.schema import Schema

Array = NDArray[np.float64]
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
    """The camera's cable: how far it may be wound around the arm."""

    max_turns: float = Field(gt=0, le=20, description="most turns by which the cable may be wound up, summed over its joints")
    joints: list[int] = Field(default=[], description="numbers of the joints that wind it, from 1; empty: the last joint")
    rest_deg: list[float] = Field(default=[], description="their angles where the cable is not wound; empty: zero")

    def turns(self, joints: ArrayLike) -> Array:
        """(...) turns by which the cable is wound at (..., n) joint angles [rad]: the travel of its joints from their rest."""
        joints = np.asarray(joints, np.float64)
        winding = [number - 1 for number in self.joints] or [joints.shape[-1] - 1]
        rest = np.radians(self.rest_deg or np.zeros(len(winding)))
        return np.asarray(np.abs(joints[..., winding] - rest).sum(-1) / (2 * np.pi))


@dataclass(frozen=True)
class Carrier:
    """An arm and the camera that it carries."""

    arm: ArmModel
    flange_from_camera: Array  # (4, 4) nominal mount [m]
    body: tuple[CameraCapsule, ...] = BODY
    solids: tuple[Solid, ...] = ()  # what stands around the arm
    cable: Cable | None = None  # None: the cable is no limit
    turntable: TurntableDescription | None = None  # what turns the object; None: it stands

    @cached_property
    def shape(self) -> Shape:
        """The parts of the arm, the bracket, and the parts of the camera."""
        last, mount = self.arm.count, np.asarray(self.flange_from_camera, np.float64)
        origin = np.zeros(3)
        bracket = Part("bracket", BRACKET_RADIUS, last, origin, mount[:3, 3], can_hide=False)
        camera = [
            Part(
                one.name,
                one.radius,
                last,
                mount[:3, :3] @ one.start + mount[:3, 3],
                mount[:3, :3] @ one.end + mount[:3, 3],
                neighbours=0,
                can_hide=False,
            )
            for one in self.body
        ]
        return Shape((*self.arm.parts, bracket, *camera))

    def base_from_camera(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) nominal camera pose [m] at (..., n) joint angles [rad]."""
        return np.asarray(self.arm.forward(joints) @ self.flange_from_camera)

    def segments(self, joints: ArrayLike) -> Array:
        """(..., parts, 2, 3) ends of the axes of the parts of `shape` in the base [m], at (..., n) joint angles [rad]."""
        return self.shape.segments(self.arm.frames(joints))

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


Mount: TypeAlias = Carrier | NDArray[np.float64]
"""A carrier, or the (4, 4) mount of a camera [m] on the default arm with nothing else around it."""


def carrier_of(mount: Mount) -> Carrier:
    """The carrier that a mount means."""
    return mount if isinstance(mount, Carrier) else Carrier(load_arm(DEFAULT), np.asarray(mount, np.float64))
