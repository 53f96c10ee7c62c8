"""The description of a folder of images and poses that another program recorded, as a person writes it.

format: koala-import
version: 1
images: "image-*.png"            # the part matched by * is the name of the view
poses: "pose-*.yaml"             # a file for each image, or one file for all
key: data                        # where in a YAML, JSON or XML file; a.b for b inside a
layout: x y z a b c              # what the numbers of a pose are, in the order of the file
euler: ZYX                       # of three Euler angles: the axes, in the order of the file
board: {type: chessboard, squares_x: 10, squares_y: 7, square_length_m: 0.0236}
"""

from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from koala3d import configs
from koala3d.datasets import conventions
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.targets.board import Board, load_board

DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Layout = Literal[
    "x y z rx ry rz",
    "x y z a b c",
    "x y z w p r",
    "x y z roll pitch yaw",
    "x y z qw qx qy qz",
    "x y z qx qy qz qw",
    "matrix",
    "matrix by columns",
]
_AXES = ["".join(axes) for axes in product("xyz", repeat=3) if axes[0] != axes[1] != axes[2]]
SEQUENCES = ("", "xyz", "ZYX", "ZYZ", "XYZ", *sorted({*_AXES, *map(str.upper, _AXES)} - {"xyz", "ZYX", "ZYZ", "XYZ"}))
"""Sequences of axes as SciPy writes them, the usual ones first: fixed axes in small letters, moving axes in capitals. The empty
one stands for a rotation vector."""


def _named(board: Any) -> Any:
    """A board that is given by its name or its file; anything else as it is."""
    return load_board(configs.find("boards", board)) if isinstance(board, str) else board


NamedBoard = Annotated[Board, BeforeValidator(_named)]


def _without_zeros(distortion: Any) -> Any:
    """Coefficients without zeros after the last that is kept: some programs always write twelve or fourteen."""
    if isinstance(distortion, list) and len(distortion) > len(DISTORTION):
        if any(distortion[len(DISTORTION) :]):
            possible = f"possible are {' '.join(DISTORTION)}, any after them must be 0"
            raise ValueError(f"{len(distortion)} coefficients: {possible}; or leave camera out, so that it is estimated along")
        return distortion[: len(DISTORTION)]
    return distortion


class CameraNumbers(Schema):
    """A camera calibrated elsewhere; it is kept as it is."""

    width: int = Field(ge=16, description="of the images [px]")
    height: int = Field(ge=16, description="of the images [px]")
    fx: float = Field(gt=0, description="focal length [px]")
    fy: float = Field(gt=0, description="focal length [px]")
    cx: float = Field(description="principal point [px]")
    cy: float = Field(description="principal point [px]")
    distortion: Annotated[list[float], BeforeValidator(_without_zeros)] = Field(
        default=[], description="k1 k2 p1 p2 k3 k4 k5 k6, as many as there are; zeros may follow"
    )
    first_pixel: float = Field(0, ge=0, le=0.5, multiple_of=0.5, description="centre of the first pixel; 0 for OpenCV, ViSP [px]")

    def camera(self) -> Camera:
        """In our pixel coordinates."""
        shift, bent = conventions.OPENCV_PIXEL_SHIFT - self.first_pixel, dict(zip(DISTORTION, self.distortion, strict=False))
        return Camera(self.width, self.height, self.fx, self.fy, self.cx + shift, self.cy + shift, **bent)


class Description(Schema):
    """How a folder of images and poses is to be read."""

    format: Literal["koala-import"] = Field(default="koala-import", description="what this file is")
    version: Literal[1] = Field(default=1, description="version of this format")
    images: str = Field(description="pattern of the images in the folder, with one *, which names the view")
    poses: str = Field(
        description="pattern of the pose files, with one *, or the one file of all poses (.csv .txt .npy .yaml .json .xml)"
    )
    key: str = Field(default="", description="where the numbers are in a YAML, JSON or XML file; a.b for b inside a")
    layout: Layout = Field(description="meaning and order of the numbers of a pose")
    euler: str = Field(
        default="",
        description="axes of three Euler angles in the order of the layout: xyz about fixed axes, ZYX about moving ones",
    )
    length: Literal["m", "mm"] = Field(default="m", description="unit of lengths")
    angle: Literal["rad", "deg"] = Field(default="rad", description="unit of rotation vectors and Euler angles")
    inverse: bool = Field(default=False, description="true where the poses are flange_from_base; else base_from_flange")
    eye_to_hand: bool = Field(default=False, description="true where the camera stands beside the arm and holds still")
    board: NamedBoard = Field(description="the target: name of a shipped board, a board file, or type, squares_x, ...")
    camera: CameraNumbers | None = Field(default=None, description="a camera calibrated elsewhere; null: estimated along")

    @model_validator(mode="after")
    def _one_star(self) -> Self:
        if self.images.count("*") != 1 or self.poses.count("*") > 1:
            raise ValueError("images needs exactly one * in its pattern, poses at most one")
        return self

    @model_validator(mode="after")
    def _axes(self) -> Self:
        usual = "xyz for roll, pitch, yaw and W P R; ZYX for KUKA's A B C; ZYZ; XYZ"
        if self.euler not in SEQUENCES:
            raise ValueError(
                f"euler {self.euler!r} is no sequence of three axes, fixed in small letters, moving in capitals: {usual}"
            )
        if self.euler and not self.has_angles:
            raise ValueError(f"euler is for three angles, layout {self.layout!r} has none")
        if self.has_angles and not self.euler and self.layout != "x y z rx ry rz":
            raise ValueError(f"layout {self.layout!r} needs euler, the sequence of its axes: {usual}")
        return self

    @property
    def has_angles(self) -> bool:
        """Whether a pose has three angles: a rotation vector or Euler angles."""
        return "matrix" not in self.layout and "q" not in self.layout

    @property
    def columns(self) -> list[str]:
        """Name of each number of a pose, as the header of a CSV file has it."""
        if "matrix" in self.layout:
            return [f"m{row}{column}" for row in range(4) for column in range(4)]
        return [*self.layout.split()]


def load_description(description: Path) -> Description:
    """A shipped description by its name, or one in a file. Raises UsageError where it is missing or wrong."""
    return load_yaml(configs.find("imports", description), Description)
