"""Trajectory files: which views to take of what, with which exposure and how fast. The schema is the documentation.

    trajectory = load_trajectory("configs/trajectories/koala_demo.yaml")
    for viewpoint in trajectory.viewpoints(): ...

Positions in metres in the robot's base frame, angles in degrees where a person writes them. Viewpoints are of the camera.
"""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from capture.rig.description import PoseDescription, Vector
from capture.viewpoints import GridViews, HemisphereViews, JointViews, OrbitViews, PoseViews, TiltedViews, Viewpoint, spread
from datasets import pose
from datasets.board import Board
from datasets.core.schema import Schema, load_yaml

FORMAT, VERSION = "koala-trajectory", 1

Views = Annotated[HemisphereViews | OrbitViews | GridViews | TiltedViews | PoseViews | JointViews, Field(discriminator="kind")]


class Split(Schema):
    """How many views train and how many test; test views lie spread between the training views."""

    train: int = Field(ge=1, description="number of training views")
    test: int = Field(ge=0, description="number of test views")


class Box(Schema):
    """A box along the axes of the base frame."""

    centre: Vector = Field(description="centre in the base frame [m]")
    size: Vector = Field(description="full extent along x, y, z [m]")

    @model_validator(mode="after")
    def _has_volume(self) -> Self:
        if min(self.size) <= 0:
            raise ValueError(f"size must be positive along every axis, got {list(self.size)}")
        return self

    @property
    def corners(self) -> NDArray[np.float64]:
        """(2, 3) lowest and highest corner [m]."""
        centre, half = np.asarray(self.centre), np.asarray(self.size) / 2
        return np.stack([centre - half, centre + half])


class CameraSettings(Schema):
    """Constant for the whole recording."""

    exposure_us: float = Field(default=10_000.0, gt=0, description="exposure time [us]")
    gain_db: float = Field(default=0.0, ge=0, description="gain [dB]")
    pixel_format: Literal["rgb8", "bayer8", "bayer12"] = Field(
        default="rgb8", description="what the camera sends: its own colours, or raw photosites of 8 or 12 bits, of which colours are made "
        "here. Images are sRGB; 12 bits are kept as 16-bit files",
    )  # fmt: skip
    binning: int = Field(default=1, ge=1, le=16, description="sensor pixels per image pixel, along both axes")
    width: int = Field(default=1920, ge=16, description="image width after binning [px]")
    height: int = Field(default=1080, ge=16, description="image height after binning [px]")
    offset_x: int | None = Field(default=None, ge=0, description="left edge of the region after binning [px]; default: centred")
    offset_y: int | None = Field(default=None, ge=0, description="upper edge of the region after binning [px]; default: centred")


class Motion(Schema):
    """How the arm moves between views, and when it counts as still."""

    order: Literal["given", "shortest"] = Field(
        default="given", description="take the views as listed, or in an order that saves time"
    )
    speed: float = Field(default=0.8, gt=0, le=np.pi, description="fastest joint [rad/s]")
    acceleration: float = Field(default=1.2, gt=0, le=10, description="of the fastest joint [rad/s^2]")
    settle_speed: float = Field(default=0.001, gt=0, description="every joint slower than this counts as still [rad/s]")
    settle_time_s: float = Field(default=0.3, ge=0, le=60, description="how long it must have been still before the exposure [s]")
    settle_difference: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="also wait until two pictures in a row differ by less, rms share of white; null: do not",
    )
    settle_timeout_s: float = Field(
        default=5.0, gt=0, description="error where the arm is not still this long after the motion [s]"
    )


class Safety(Schema):
    """Where no part of the arm or the camera may be."""

    table_z: float | None = Field(default=0.0, description="z of the table's top in the base frame [m]; null: no table")
    ceiling_z: float | None = Field(default=None, description="z of the ceiling that an arm hangs from, mostly 0 [m]; null: none")
    clearance_m: float = Field(default=0.02, ge=0, le=0.5, description="distance kept to table, object and the arm itself [m]")
    workspace: Box | None = Field(default=None, description="the camera stays inside this box; null: anywhere")


class Trajectory(Schema):
    """A repeatable session: views, split, camera settings, motion, and what stands where."""

    format: Literal["koala-trajectory"] = Field(default="koala-trajectory", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$", description="name of the session")
    views: list[Views] = Field(min_length=1, description="groups of views, taken in this order")
    split: Split | None = Field(
        default=None, description="training and test views; null: a calibration session, or all for training"
    )
    camera: CameraSettings = Field(default_factory=CameraSettings, description="exposure, gain and region")
    motion: Motion = Field(default_factory=Motion, description="speed and settling")
    safety: Safety = Field(default_factory=Safety, description="where the arm may not go")
    up: Literal["+z", "-z"] = Field(
        default="+z", description="the base's axis that points up: -z for an arm that hangs upside down"
    )
    object: Box | None = Field(default=None, description="the object's volume; the object stands in the middle of its bottom")
    target: Board | None = Field(default=None, description="calibration target, for a calibration session")
    board: PoseDescription | None = Field(
        default=None,
        description="base_from_board, roughly. The simulator puts the board exactly here; nothing else reads it. "
        "Board axes: x along squares_x, y along squares_y, z into the board, origin at the first corner",
    )

    @model_validator(mode="after")
    def _counts_agree(self) -> Self:
        count = sum(group.number for group in self.views)
        if self.split is not None and self.split.train + self.split.test != count:
            raise ValueError(f"split asks for {self.split.train} + {self.split.test} views, but views give {count}")
        if self.split is not None and self.target is not None:
            raise ValueError("a session with a target has no split: leave out 'split' or 'target'")
        if self.target is not None and self.target.kind != "charuco":
            raise ValueError(f"target: sessions are recorded of ChArUco boards only, not of kind {self.target.kind!r}")
        return self

    @model_validator(mode="after")
    def _table_below(self) -> Self:
        table, ceiling = self.safety.table_z, self.safety.ceiling_z
        if self.up == "-z" and table is not None and table <= 0:
            raise ValueError(f"with up: -z the table is at a positive z, before the hanging arm, but safety.table_z is {table:g}")
        if table is not None and ceiling is not None and (ceiling - table) * self.upwards <= 0:
            raise ValueError(f"safety.ceiling_z {ceiling:g} is not above safety.table_z {table:g} where up is {self.up}")
        return self

    @property
    def upwards(self) -> int:
        """The base's z of a step upwards: 1, or -1 for an arm that hangs."""
        return 1 if self.up == "+z" else -1

    @property
    def base_from_table(self) -> NDArray[np.float64]:
        """(4, 4) [m] of a frame whose x axis is the base's, z up and 0 at the table's top (at the base where there is no table)."""
        up = self.upwards
        return pose.rigid(np.diag([1.0, up, up]), [0.0, 0.0, self.safety.table_z or 0.0])

    @property
    def splits(self) -> list[str]:
        """ "train" or "test" of each view in order; "calibration" throughout for a target session."""
        count = sum(group.number for group in self.views)
        if self.target is not None:
            return ["calibration"] * count
        test = spread(count, self.split.test) if self.split is not None else frozenset()
        return ["test" if index in test else "train" for index in range(count)]

    def viewpoints(self) -> list[Viewpoint]:
        """Every view in order, named "000", "001", ..."""
        views = [view for group in self.views for view in group.generate(self.upwards)]
        digits = max(3, len(str(len(views) - 1)))
        return [
            Viewpoint(f"{index:0{digits}d}", split, view.base_from_camera, view.rolls, view.joints)
            for index, (view, split) in enumerate(zip(views, self.splits, strict=True))
        ]


def load_trajectory(path: Path | str, *, overrides: list[str] | None = None) -> Trajectory:
    """Read a trajectory file; raises UsageError in one line (file, line, key, nearest valid key) where something is wrong."""
    return load_yaml(path, Trajectory, overrides=overrides or [])
