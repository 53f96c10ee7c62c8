"""Calibration targets as board files, trajectories, recordings and calibrations describe them.

Board frame (OpenCV's): origin in the outer corner of the first square, x along the rows of squares, y along the columns, z into
the board. Corners of a checkered board are numbered row by row; corner (i, j) lies at ((i + 1), (j + 1), 0) square lengths.

A grid of tags (AprilTag or ArUco) has one tag in the middle of each square, numbered row by row from `first_id`. Its tag n has
the corners 4 n to 4 n + 3, clockwise from the upper left one of the tag as OpenCV draws it.

An AprilGrid is Kalibr's: tags numbered row by row from below, each turned by half a turn against OpenCV's drawing, and small dark
squares in the gaps, which touch the corners of the tags. A square is a tag and a gap.

Circles are numbered row by row, one in the middle of each square. Of asymmetric circles a row has `squares_x`, two square
lengths apart, rows are one square length apart, and every other row is shifted by one square length.
"""

from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, Field, model_validator

from koala3d.datasets.core.schema import Schema, load_yaml
from koala3d.datasets.targets import kalibr

Kind = Literal["charuco", "chessboard", "tags", "aprilgrid", "circles", "asymmetric_circles"]
KALIBR = {"dictionary": "DICT_APRILTAG_36h11", "border_bits": 2}
"""What an AprilGrid has unless it says otherwise."""
_AROUND = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Corners of a tag as OpenCV draws and reads it, about its middle in halves of its side."""


class Board(Schema):
    """A flat calibration target: ChArUco board, chessboard, grid of tags or circles."""

    kind: Kind = Field(validation_alias=AliasChoices("kind", "type"), description="kind of target (type in recordings)")
    squares_x: int = Field(ge=1, description="squares along the board's x axis, or tags, or circles of a row")
    squares_y: int = Field(ge=1, description="squares along the board's y axis, or rows of tags or circles")
    square_length_m: float = Field(gt=0, description="side of a square, or distance of neighbouring tags, circles or rows [m]")
    marker_length_m: float = Field(
        default=0.0, ge=0, description="side of a marker with its border, or diameter of a circle; not of a chessboard [m]"
    )
    dictionary: str = Field(
        default="DICT_5X5_100", description="OpenCV's name of the marker dictionary; default of an aprilgrid: DICT_APRILTAG_36h11"
    )
    legacy_pattern: bool = Field(
        default=False, description="true for boards made by OpenCV before 4.6 with an even number of rows"
    )
    first_id: int = Field(default=0, ge=0, description="number of the first tag; tags and aprilgrid only")
    border_bits: int = Field(
        default=1,
        ge=1,
        le=4,
        description="width of a marker's dark border in cells; default of an aprilgrid: 2, as Kalibr prints",
    )

    @classmethod
    def of(
        cls,
        kind: Kind,
        squares_x: int,
        squares_y: int,
        square_length_m: float,
        marker_length_m: float = 0.0,
        dictionary: str = "",
        first_id: int = 0,
    ) -> Self:
        """A board by what is printed on it: kind, squares, their side, that of a marker, dictionary, number of the first tag."""
        sizes = {"squares_x": squares_x, "squares_y": squares_y, "square_length_m": square_length_m}
        content = {"kind": kind, **sizes, "marker_length_m": marker_length_m, "first_id": first_id}
        return cls.model_validate({**content, **({"dictionary": dictionary} if dictionary else {})})

    @model_validator(mode="before")
    @classmethod
    def _as_kalibr_prints(cls, content: Any) -> Any:
        if isinstance(content, dict) and "target_type" in content:
            content = kalibr.board(content)
        if isinstance(content, dict) and content.get("kind", content.get("type")) == "aprilgrid":
            return {**KALIBR, **content}
        return content

    @model_validator(mode="after")
    def _can_exist(self) -> Self:
        if not self.has_tags and min(self.squares_x, self.squares_y) < 3:
            raise ValueError(f"{self.squares_x}x{self.squares_y} squares are too few; a board without tags needs 3x3")
        if self.looks_the_same_after_a_quarter_turn:
            what = "circles" if self.kind == "circles" else "squares"
            raise ValueError(f"{self.squares_x}x{self.squares_y} {what} look the same after a quarter turn: take 1 more one way")
        room = self.square_length_m * (np.sqrt(2) if self.kind == "asymmetric_circles" else 1.0)
        fits = 0 < self.marker_length_m < room
        if self.kind != "chessboard" and not (fits or (self.kind == "tags" and self.marker_length_m == self.square_length_m)):
            limit = "smaller than square_length_m" if room == self.square_length_m else "smaller than 1.414 x square_length_m"
            raise ValueError(f"marker_length_m {self.marker_length_m} must be above 0 and {limit} {self.square_length_m}")
        return self

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary as manifests and calibration files hold it: `kind` is called "type" there."""
        described = self.model_dump(mode="json")
        return {"type": described.pop("kind"), **described}

    @property
    def has_tags(self) -> bool:
        """Whether the corners are those of tags."""
        return self.kind in ("tags", "aprilgrid")

    @property
    def has_circles(self) -> bool:
        """Whether the corners are middles of circles."""
        return self.kind in ("circles", "asymmetric_circles")

    @property
    def is_checkered(self) -> bool:
        """Whether squares are dark and light in turn."""
        return self.kind in ("charuco", "chessboard")

    @property
    def has_markers(self) -> bool:
        """Whether markers of a dictionary are printed on it."""
        return self.kind == "charuco" or self.has_tags

    @property
    def is_seen_whole(self) -> bool:
        """Whether a picture must show all of it to be of use."""
        return self.kind == "chessboard" or self.has_circles

    @property
    def is_ambiguous(self) -> bool:
        """True for a chessboard or a grid of circles that looks the same after half a turn."""
        if self.kind == "asymmetric_circles":
            return self.squares_y % 2 == 0
        return self.kind == "circles" or (self.kind == "chessboard" and (self.squares_x + self.squares_y) % 2 == 0)

    @property
    def looks_the_same_after_a_quarter_turn(self) -> bool:
        """Whether it does; a chessboard with as many squares along x as along y does not if their number is even."""
        alike = self.kind == "circles" or (self.kind == "chessboard" and self.squares_x % 2 == 1)
        return alike and self.squares_x == self.squares_y

    @property
    def size(self) -> NDArray[np.float64]:
        """(2,) extent along x and y [m]."""
        along = 2 * self.squares_x if self.kind == "asymmetric_circles" else self.squares_x
        return self.square_length_m * np.array([along, self.squares_y], np.float64)

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """(n, 2) middles of tags or circles in the order of their numbers, in the board frame [m]."""
        column, row = np.meshgrid(np.arange(self.squares_x), np.arange(self.squares_y))
        if self.kind == "asymmetric_circles":
            column = 2 * column + row % 2
        if self.kind == "aprilgrid":
            row = row[::-1]
        return np.asarray((np.stack([column.ravel(), row.ravel()], -1) + 0.5) * self.square_length_m, np.float64)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(corners, 3) inner corners, corners of tags, or middles of circles, in the board frame [m]."""
        if self.has_tags:
            upright = -1 if self.kind == "aprilgrid" else 1
            flat = (self.centres[:, None] + upright * _AROUND * self.marker_length_m / 2).reshape(-1, 2)
        elif self.has_circles:
            flat = self.centres
        else:
            x, y = np.meshgrid(np.arange(1, self.squares_x), np.arange(1, self.squares_y))
            flat = np.stack([x.ravel(), y.ravel()], -1) * self.square_length_m
        return np.asarray(np.column_stack([flat, np.zeros(len(flat))]), np.float64)

    def with_squares(self, x: int, y: int, scale: float = 1.0) -> Self:
        """The same kind of board with so many squares, everything printed `scale` times as large."""
        lengths = {"square_length_m": scale * self.square_length_m, "marker_length_m": scale * self.marker_length_m}
        return self.model_copy(update={"squares_x": x, "squares_y": y, **lengths})


def load_board(path: Path) -> Board:
    """Read a board file. Raises UsageError where it is missing, or something in it is wrong."""
    return load_yaml(path, Board)
