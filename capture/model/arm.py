"""Arms by file: chain, limits and shape of each model, and which model an arm is by what it reports.

arm = load_arm("ur10e")
arm.inverse(arm.forward(joints))
identify(joints, base_from_flange).name  # "UR10e"
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from koala3d import configs
from koala3d.capture.model import urdf
from koala3d.capture.model.inverse.solver import Solver, branches, solver_for
from koala3d.capture.model.parts import Part
from koala3d.capture.model.shapes.geometry import Vector
from koala3d.datasets import kinematics, pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema, load_yaml, validate
from koala3d.datasets.kinematics import MAX_JOINTS, Links
from koala3d.datasets.recording import MANIFEST, Recording

Array = NDArray[np.float64]
Numbers = list[float]
Matrix = list[list[float]]
BUILT_M = 0.05
"""Farther from where its nominal links put it, the flange belongs to another arm; real arms differ by up to centimetres [m]."""
DEFAULT = "ur5e"
"""The arm of a rig or a recording that names none."""


class DenavitHartenberg(Schema):
    """A chain: previous_from_link = rot_z(theta) trans_z(d) trans_x(a) rot_x(alpha), between two fixed transforms."""

    d: Numbers = Field(min_length=1, max_length=MAX_JOINTS, description="lengths along the joint axes [m]")
    a: Numbers = Field(description="lengths across the joint axes [m]")
    alpha_deg: Numbers = Field(description="twists from one joint axis to the next")
    theta_deg: Numbers | None = Field(default=None, description="angles of the links at zero joint angles; null: zero")
    base: Matrix | None = Field(default=None, description="(4, 4) pose of the first joint's frame in the base; null: the same")
    tool: Matrix | None = Field(default=None, description="(4, 4) pose of the flange in the last frame; null: the same")


class UrdfReference(Schema):
    """A chain in a URDF file."""

    file: str = Field(min_length=1, description="path of the URDF, relative to this file")
    base: str = Field(min_length=1, description="link that is the base, in which poses are given")
    flange: str = Field(min_length=1, description="link that is the flange, on which the camera's bracket is")


class JointLimits(Schema):
    """Limits of each joint. From a URDF come those that are null."""

    lower_deg: Numbers | None = Field(default=None, description="smallest angle")
    upper_deg: Numbers | None = Field(default=None, description="largest angle")
    speed_deg: Numbers | None = Field(default=None, description="highest speed [degrees/s]")
    acceleration_deg: Numbers = Field(description="highest acceleration [degrees/s^2]")


class LinkCapsule(Schema):
    """All points within a radius of a line segment that moves with a link."""

    name: str = Field(min_length=1, description="what a person calls this part of the arm")
    link: int = Field(ge=0, description="number of joints between the base and this part")
    start: Vector = Field(description="one end of the segment in the frame of the link [m]")
    end: Vector = Field(description="other end of the segment [m]")
    radius: float = Field(gt=0, le=1, description="radius [m]")
    table: bool = Field(default=True, description="whether it could reach the table or the ceiling")
    object: bool = Field(default=True, description="whether it could reach the object and other bodies")


class ArmModel(Schema):
    """One model of arm, as a file in `configs/arms` describes it. Arrays that it gives are (n,) over the joints."""

    format: Literal["koala-arm"] = Field(description="kind of file")
    version: Literal[1] = Field(description="version of the format")
    name: str = Field(min_length=1, description="as its maker writes it")
    family: Literal["ur", "other"] = Field(default="other", description="ur: closed form and controller of Universal Robots")
    dh: DenavitHartenberg | None = Field(default=None, description="chain by Denavit-Hartenberg parameters; or give urdf")
    urdf: UrdfReference | None = Field(default=None, description="chain from a URDF file; or give dh")
    limits: JointLimits = Field(description="limits of each joint")
    home_deg: Numbers = Field(description="angles out of the way, near which the planner stays")
    hanging_home_deg: Numbers | None = Field(default=None, description="the same for an arm that hangs; null: home_deg")
    capsules: list[LinkCapsule] = Field(min_length=1, description="shape of the arm, from the base to the flange")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.dh is None) == (self.urdf is None):
            raise ValueError("give either dh or urdf")
        if self.dh is not None:
            count, limits = len(self.dh.d), self.limits
            lists: dict[str, Numbers | None] = {"dh.a": self.dh.a, "dh.alpha_deg": self.dh.alpha_deg, "home_deg": self.home_deg}
            lists |= {"dh.theta_deg": self.dh.theta_deg, "hanging_home_deg": self.hanging_home_deg}
            lists |= {f"limits.{name}": getattr(limits, name) for name in JointLimits.model_fields}
            for name, values in lists.items():
                if values is not None and len(values) != count:
                    raise ValueError(f"{name} has {len(values)} numbers, but dh.d gives the arm {count} joints")
                if values is None and name.startswith("limits."):
                    raise ValueError(f"{name} is missing")
            if (self.lower >= self.upper).any() or min(self.speed.min(), self.acceleration.min()) <= 0:
                raise ValueError("limits: lower must be below upper, speeds and accelerations positive")
            if max(capsule.link for capsule in self.capsules) > count:
                raise ValueError(f"capsules: a link has a number above {count}")
        names = [capsule.name for capsule in self.capsules]
        if len(set(names)) < len(names):
            raise ValueError("capsules: two have the same name")
        return self

    @cached_property
    def links(self) -> Links:
        """The nominal chain."""
        assert self.dh is not None  # `load_arm` replaces a URDF
        return Links.from_json(self.dh.model_dump(), where=self.name)

    @property
    def count(self) -> int:
        """Number of joints."""
        return self.links.count

    @cached_property
    def lower(self) -> Array:
        """Smallest angles [rad]."""
        return np.radians(self.limits.lower_deg or [])

    @cached_property
    def upper(self) -> Array:
        """Largest angles [rad]."""
        return np.radians(self.limits.upper_deg or [])

    @cached_property
    def speed(self) -> Array:
        """Highest speeds [rad/s]."""
        return np.radians(self.limits.speed_deg or [])

    @cached_property
    def acceleration(self) -> Array:
        """Highest accelerations [rad/s^2]."""
        return np.radians(self.limits.acceleration_deg)

    @cached_property
    def home(self) -> Array:
        """Angles out of the way [rad]."""
        return np.radians(self.home_deg)

    @cached_property
    def hanging_home(self) -> Array:
        """The same for an arm that hangs [rad]."""
        return np.radians(self.hanging_home_deg or self.home_deg)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The shape of the arm."""
        return tuple(
            Part(one.name, one.radius, one.link, np.array(one.start), np.array(one.end), 2, one.table, one.object)
            for one in self.capsules
        )

    def forward(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) `base_from_flange` [m] of (..., n) joint angles [rad], by the nominal links."""
        return kinematics.forward(joints, self.links)

    def frames(self, joints: ArrayLike) -> Array:
        """(..., n + 1, 4, 4) poses of base and links [m]."""
        return kinematics.link_frames(joints, self.links)

    def inverse(self, base_from_flange: ArrayLike) -> Array:
        """(m, n) joint angles [rad, -pi..pi] of the branches that reach the (4, 4) pose, in or out of limits; m = 0: none.

        An arm with six joints has up to 8 or 16. With seven joints they are infinitely many, and a sample is given.
        """
        target = np.ascontiguousarray(base_from_flange, np.float64)
        if self.wrist_distance(target) > 1.05 * self.reach:
            return np.zeros((0, self.count))
        return branches(target, self.links, self._solver[1], family=self.family)

    @property
    def solver(self) -> str:
        """What solves the inverse kinematics: "eaik", "ur" or "numerical"."""
        return self._solver[0]

    @cached_property
    def _solver(self) -> tuple[str, Solver]:
        return solver_for(self.links, self.family, self.lower, self.upper)

    def inside(self, joints: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """(...) whether (..., n) angles [rad] are within the limits of all joints by a margin [rad]."""
        joints = np.asarray(joints, np.float64)
        return np.asarray(((joints >= self.lower + margin) & (joints <= self.upper - margin)).all(axis=-1))

    def outside(self, joints: ArrayLike) -> str:
        """The joint that is farthest outside its limits, in words; empty where (n,) angles are within."""
        joints = np.asarray(joints, np.float64)
        worst = int(np.maximum(joints - self.upper, self.lower - joints).argmax())
        if self.inside(joints):
            return ""
        limit = self.upper[worst] if joints[worst] > self.upper[worst] else self.lower[worst]
        return f"joint {worst + 1} at {np.degrees(joints[worst]):.0f} degrees, limit {np.degrees(limit):.0f}"

    @cached_property
    def reach(self) -> float:
        """Largest distance of the wrist, the last joint's frame, from the shoulder [m], to a percent; see `wrist_distance`."""
        low, high = np.maximum(self.lower, -np.pi), np.minimum(self.upper, np.pi)
        angles = np.random.default_rng(0).uniform(low, high, (20_000, self.count))
        return float(np.linalg.norm(self.frames(angles)[:, -2, :3, 3] - self._shoulder, axis=-1).max())

    def wrist_distance(self, base_from_flange: Array) -> float:
        """Distance [m] of the wrist from the shoulder, a point on the first joint's axis, at a (4, 4) pose of the flange."""
        frames = self.frames(np.zeros(self.count))
        wrist = base_from_flange @ pose.inverse(frames[-1]) @ frames[-2]
        return float(np.linalg.norm(wrist[:3, 3] - self._shoulder))

    @property
    def _shoulder(self) -> Array:
        first = self.links.base
        return np.asarray(first[:3, 3] + self.links.d[0] * first[:3, 2])


@dataclass(frozen=True)
class Identified:
    """The model that fits best, and how far its nominal flange is from the reported one [m]."""

    model: ArmModel
    distance_m: float

    @property
    def certain(self) -> bool:
        """Whether it can be that model at all."""
        return self.distance_m < BUILT_M

    def may_be(self, other: ArmModel) -> bool:
        """Whether it is that model, or one with the same links: a UR7e reports what a UR5e reports."""
        return self.model.links.to_json() == other.links.to_json()


@lru_cache(32)
def load_arm(name: Path | str) -> ArmModel:
    """A shipped model by its name, or one from a file; raises UsageError with the file, the line and the key."""
    path = configs.find("arms", name)
    found = load_yaml(path, ArmModel)
    return found if found.urdf is None else _resolved(found, found.urdf, path)


def _resolved(arm: ArmModel, reference: UrdfReference, path: Path) -> ArmModel:
    """The same arm with the chain of its URDF, with limits that were missing, and with capsules in the chain's own frames."""
    chain = urdf.read_chain(path.parent / reference.file, reference.base, reference.flange)
    from_file = {"lower_deg": chain.lower, "upper_deg": chain.upper, "speed_deg": chain.speed}
    limits = arm.limits.model_dump()
    for name, values in from_file.items():
        if limits[name] is None:
            if not np.isfinite(values).all():
                raise UsageError(f"limits.{name} is missing", where=path, why="the URDF does not say it for every joint")
            limits[name] = np.degrees(values).tolist()
    capsules = []
    for capsule in arm.capsules:
        if capsule.link > chain.links.count:
            raise UsageError(f"capsules: link {capsule.link} is above {chain.links.count}", where=path, why=capsule.name)
        place = chain.own_frames[capsule.link]
        ends = {name: (place[:3, :3] @ getattr(capsule, name) + place[:3, 3]).tolist() for name in ("start", "end")}
        capsules.append({**capsule.model_dump(), **ends})
    content = {**arm.model_dump(), "urdf": None, "dh": chain.links.to_json(), "limits": limits, "capsules": capsules}
    return validate(content, ArmModel, where=path)


def recorded_arm(recording: Recording) -> ArmModel:
    """The arm of a recording."""
    return validate(recording.part("arm"), ArmModel, where=f"{recording.path / MANIFEST}, arm")


@lru_cache(1)
def shipped_arms() -> tuple[ArmModel, ...]:
    """Every model that is installed."""
    return tuple(load_arm(name) for name in configs.shipped("arms"))


def identify(joints: ArrayLike, base_from_flange: ArrayLike) -> Identified:
    """The shipped model whose nominal links bring the flange nearest to the reported (4, 4) pose [m] at these angles [rad].

    Lengths of the models differ by decimetres, and builds of one model by millimetres. Orientations are equal in a family. Of
    models with the same links the first one by file name is returned.
    """
    joints = np.asarray(joints, np.float64)
    models = [model for model in shipped_arms() if model.count == len(joints)]
    reached = ((model, pose.difference(model.forward(joints), base_from_flange)[0]) for model in models)
    model, distance = min(reached, key=lambda one: float(one[1]))
    return Identified(model, float(distance))
