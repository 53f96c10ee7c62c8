"""Trajectory files: which views to take, with which exposure, and how fast. The schema is the documentation.

    trajectory = load_trajectory("koala_demo")  # or the path of a file
    for viewpoint in trajectory.viewpoints(): ...

Positions are in metres in the robot's base frame, and angles that a person writes in degrees. Viewpoints are camera poses.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from koala3d import configs
from koala3d.capture.model.shapes.geometry import BoardPlace, Box
from koala3d.capture.model.viewpoints import (
    GridViews,
    HemisphereViews,
    JointViews,
    OrbitViews,
    PoseViews,
    TiltedViews,
    Viewpoint,
    spread,
)
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema, load_yaml, validate
from koala3d.datasets.recording import MANIFEST, Recording
from koala3d.datasets.targets.board import Board, load_board

FORMAT, VERSION = "koala-trajectory", 1

Views = Annotated[HemisphereViews | OrbitViews | GridViews | TiltedViews | PoseViews | JointViews, Field(discriminator="kind")]


class Split(Schema):
    """Numbers of training and test views. Test views are spread evenly between the training views."""

    train: int = Field(ge=1, description="number of training views")
    test: int = Field(ge=0, description="number of test views")


class CameraSettings(Schema):
    """Camera settings, constant over the recording."""

    exposure_us: float = Field(
        default=10_000.0, gt=0, description="exposure time [us]; divided by the binning where a camera adds up binned pixels"
    )
    gain_db: float = Field(default=0.0, ge=0, description="gain [dB]")
    pixel_format: Literal["rgb8", "bayer8", "bayer12", "mono8", "mono12"] = Field(
        default="rgb8",
        description="colours, a raw Bayer mosaic, demosaiced here, or grey; stored as sRGB of 8 bits. "
        "bayer12 and mono12: of 16 bits, and the raw values beside it",
    )
    brackets: int = Field(
        default=1, ge=1, le=8, description="exposures of each view, the longest of exposure_us; merged when the scene is built"
    )
    bracket_factor: float = Field(default=8.0, gt=1, le=100, description="how much shorter each exposure is than the one before")
    binning: int = Field(default=1, ge=1, le=16, description="sensor pixels per image pixel, along both axes")
    width: int = Field(default=1920, ge=16, description="image width after binning [px]")
    height: int = Field(default=1080, ge=16, description="image height after binning [px]")
    offset_x: int | None = Field(default=None, ge=0, description="left edge of the region after binning [px]; default: centred")
    offset_y: int | None = Field(default=None, ge=0, description="upper edge of the region after binning [px]; default: centred")

    @property
    def keeps_raw(self) -> bool:
        """Whether the values of the sensor are kept beside the developed picture."""
        return self.pixel_format.endswith("12")

    def shorter_us(self, first_us: float) -> list[float]:
        """Exposure times of a view after its first one, longest first [us]; empty without brackets."""
        return [first_us / self.bracket_factor**step for step in range(1, self.brackets)]


class Motion(Schema):
    """How the arm moves between views and when it counts as still."""

    order: Literal["given", "shortest"] = Field(default="given", description="take the views as listed, or in a shorter order")
    speed: float = Field(default=0.8, gt=0, le=np.pi, description="speed of the fastest joint [rad/s]")
    acceleration: float = Field(default=1.2, gt=0, le=10, description="acceleration of the fastest joint [rad/s^2]")
    settle_spread: float = Field(
        default=5e-5, gt=0, le=0.1, description="the arm is still when no joint angle varies by more during settle_time_s [rad]"
    )
    settle_time_s: float = Field(default=0.3, ge=0, le=60, description="how long the arm must be still before the exposure [s]")
    settle_difference: float | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="also wait until two pictures in a row differ by less (RMS, share of white); null: no",
    )
    settle_timeout_s: float = Field(default=5.0, gt=0, description="error if the arm is not still this long after the motion [s]")


class Safety(Schema):
    """Where the arm and the camera may not go."""

    table_z: float | None = Field(default=0.0, description="z of the table top in the base frame [m]; null: no table")
    ceiling_z: float | None = Field(default=None, description="z of the ceiling above a hanging arm, usually 0 [m]; null: none")
    clearance_m: float = Field(default=0.02, ge=0, le=0.5, description="distance to keep from table, object and arm [m]")
    workspace: Box | None = Field(default=None, description="box that the camera must stay inside; null: no limit")


def _named(board: Any) -> Any:
    """A board that is given by its name or its file; anything else as it is."""
    return load_board(configs.find("boards", board)) if isinstance(board, str) else board


NamedBoard = Annotated[Board, BeforeValidator(_named)]


class Trajectory(Schema):
    """A repeatable session: views, split, camera settings, motion, and where things are."""

    format: Literal["koala-trajectory"] = Field(default="koala-trajectory", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$", description="name of the session")
    views: list[Views] = Field(min_length=1, description="groups of views, taken in this order")
    split: Split | None = Field(default=None, description="training and test views; null: all train, or it is a calibration")
    camera: CameraSettings = Field(default_factory=CameraSettings, description="exposure, gain and region")
    motion: Motion = Field(default_factory=Motion, description="speed and settling")
    safety: Safety = Field(default_factory=Safety, description="where the arm may not go")
    up: Literal["+z", "-z"] = Field(default="+z", description="axis of the base that points up; -z: the arm hangs")
    object: Box | None = Field(default=None, description="volume of the object, which stands at the centre of the bottom face")
    lights: list[str] | None = Field(
        default=None,
        description="lamps of the rig file's 'lights' that are on, by name; null: all of them. A person switches them",
    )
    target: NamedBoard | None = Field(
        default=None, description="calibration target: the name of a shipped board, a board file, or its keys; null: no target"
    )
    board: BoardPlace | None = Field(
        default=None, description="where the target lies, approximately; the simulator puts it exactly here"
    )

    @model_validator(mode="after")
    def _counts_agree(self) -> Self:
        for index, group in enumerate(self.views):
            if group.turntable is not None and (wrong := group.turntable.complaint(group.number)):
                raise ValueError(f"views, group {index}: {wrong}")
        count = sum(_taken(group) for group in self.views)
        if self.split is not None and self.split.train + self.split.test != count:
            raise ValueError(f"split has {self.split.train} + {self.split.test} views, but 'views' gives {count}")
        if self.split is not None and self.target is not None:
            raise ValueError("a session with a target has no split: remove 'split' or 'target'")
        if any(group.use for group in self.views) and (self.split is not None or self.target is not None):
            other = "split" if self.split is not None else "target"
            raise ValueError(f"views with 'use' and '{other}' contradict each other: remove one of them")
        if self.lights is not None and len(set(self.lights)) < len(self.lights):
            raise ValueError(f"lights: one lamp is listed twice: {', '.join(self.lights)}")
        return self

    @model_validator(mode="after")
    def _table_below(self) -> Self:
        table, ceiling = self.safety.table_z, self.safety.ceiling_z
        if self.up == "-z" and table is not None and table <= 0:
            raise ValueError(f"with up: -z the table has a positive z, below the hanging arm, but safety.table_z is {table:g}")
        if table is not None and ceiling is not None and (ceiling - table) * self.upwards <= 0:
            raise ValueError(f"safety.ceiling_z {ceiling:g} is not above safety.table_z {table:g} (up: {self.up})")
        return self

    @property
    def upwards(self) -> int:
        """Sign of the base's z axis in the upward direction: 1, or -1 for an arm that hangs."""
        return 1 if self.up == "+z" else -1

    @property
    def base_from_table(self) -> NDArray[np.float64]:
        """(4, 4) pose [m] of the table's frame: x as in the base, z up, origin on the table top below the base's origin.

        Without a table the origin is that of the base.
        """
        up = self.upwards
        return pose.rigid(np.diag([1.0, up, up]), [0.0, 0.0, self.safety.table_z or 0.0])

    @property
    def base_from_board(self) -> NDArray[np.float64]:
        """(4, 4) pose [m] at which `board` puts the target. Raises UsageError without `target` or `board`."""
        if self.target is None or self.board is None:
            raise UsageError("does not say where which target lies", where=self.name, remedy="state 'target' and 'board'")
        return self.board.matrix(self.target.size)

    @property
    def base_from_middle(self) -> NDArray[np.float64] | None:
        """(4, 4) pose [m] of the target's middle, with the axes of the board frame; None without `target` or `board`."""
        if self.target is None or self.board is None:
            return None
        return self.base_from_board @ pose.rigid(np.eye(3), [*(self.target.size / 2), 0.0])

    @property
    def splits(self) -> list[str]:
        """Split of each view in order: "train" or "test"; "calibration" for all views of a session with a target.

        `split` counts a view under several sets of lamps once: under all of them it is for the same.
        """
        if self.target is not None:
            return ["calibration"] * self.number
        stops = [group for group in self.views for _ in range(_taken(group))]
        test = frozenset[int]() if self.split is None else spread(len(stops), self.split.test)
        uses = [group.use or ("test" if index in test else "train") for index, group in enumerate(stops)]
        return [use for use, group in zip(uses, stops, strict=True) for _ in group.lamps or [None]]

    @property
    def switched(self) -> set[str]:
        """Names of the lamps that its views switch on."""
        return {name for group in self.views for one in group.lamps or [] for name in one}

    @property
    def switches(self) -> bool:
        """Whether lamps are switched between views."""
        return any(group.lamps is not None for group in self.views)

    @property
    def turns(self) -> bool:
        """Whether the object stands on a turntable."""
        return any(group.turntable is not None for group in self.views)

    @property
    def number(self) -> int:
        """Number of views."""
        return sum(_taken(group) * len(group.lamps or [None]) for group in self.views)

    def viewpoints(self) -> list[Viewpoint]:
        """Every view in order, named "000", "001", ..."""
        views = [view for group in self.views for view in group.under_lamps(self._turned(group))]
        digits = max(3, len(str(len(views) - 1)))
        return [
            replace(view, name=f"{index:0{digits}d}", split=split)
            for index, (view, split) in enumerate(zip(views, self.splits, strict=True))
        ]

    def _turned(self, group: Views) -> list[Viewpoint]:
        """The views of a group, at the angles of the turntable if the trajectory has one."""
        views = group.generate(self.upwards)
        if group.turntable is not None:
            return [replace(views[index], turntable=angle) for index, angle in group.turntable.taken(len(views))]
        return [replace(view, turntable=0.0) for view in views] if self.turns else views


def _taken(group: Views) -> int:
    """How many views a group gives, at all angles of the turntable, each counted once whatever lamps are on."""
    return group.number if group.turntable is None else len(group.turntable.taken(group.number))


def recorded_trajectory(recording: Recording) -> Trajectory:
    """The trajectory that a recording was made along; raises an error with the key where its manifest is wrong."""
    return validate(dict(recording.trajectory), Trajectory, where=f"{recording.path / MANIFEST}, trajectory")


def load_trajectory(path: Path | str, *, overrides: list[str] | None = None) -> Trajectory:
    """Read a trajectory file, or a shipped trajectory by name; raises UsageError with the file, the line and the key."""
    return load_yaml(configs.find("trajectories", path), Trajectory, overrides=overrides or [])
