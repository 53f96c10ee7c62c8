"""Calibration targets as trajectories, recordings and calibrations describe them.

Board frame (OpenCV's): origin in the outer corner of the first square, x along the rows of squares, y along the columns, z into
the board. Corners are numbered row by row; corner (i, j) lies at ((i + 1), (j + 1), 0) square lengths.

A grid of tags (AprilTag or ArUco) has one tag in the middle of each square, numbered row by row from `first_id`. Its tag n has
the corners 4 n to 4 n + 3, clockwise from the upper left one.
"""

from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, Field, model_validator

from datasets.core.schema import Schema

Kind = Literal["charuco", "chessboard", "tags"]


class Board(Schema):
    """A flat calibration target: a ChArUco board, a chessboard that must be seen whole, or a grid of tags."""

    kind: Kind = Field(validation_alias=AliasChoices("kind", "type"), description="kind of target (type in recordings)")
    squares_x: int = Field(ge=1, description="squares along the board's x axis")
    squares_y: int = Field(ge=1, description="squares along the board's y axis")
    square_length_m: float = Field(gt=0, description="side of a square [m]")
    marker_length_m: float = Field(default=0.0, ge=0, description="side of a marker with its border; not of a chessboard [m]")
    dictionary: str = Field(default="DICT_5X5_100", description="OpenCV's name of the marker dictionary")
    legacy_pattern: bool = Field(
        default=False, description="true for boards made by OpenCV before 4.6 with an even number of rows"
    )
    first_id: int = Field(default=0, ge=0, description="number of the first tag; tags only")

    @classmethod
    def of(
        cls,
        kind: Kind,
        squares_x: int,
        squares_y: int,
        square_length_m: float,
        marker_length_m: float = 0.0,
        dictionary: str = "DICT_5X5_100",
        first_id: int = 0,
    ) -> Self:
        """A board by what is printed on it: kind, squares, their side, that of a marker, dictionary, number of the first tag."""
        values = (kind, squares_x, squares_y, square_length_m, marker_length_m, dictionary, False, first_id)
        return cls.model_validate(dict(zip(cls.model_fields, values, strict=True)))

    @model_validator(mode="after")
    def _can_exist(self) -> Self:
        if self.kind != "tags" and min(self.squares_x, self.squares_y) < 3:
            raise ValueError(f"{self.squares_x}x{self.squares_y} squares are too few; a checkered board needs 3x3")
        fits = 0 < self.marker_length_m < self.square_length_m
        if self.kind != "chessboard" and not (fits or (self.kind == "tags" and self.marker_length_m == self.square_length_m)):
            raise ValueError(
                f"marker_length_m {self.marker_length_m} must be above 0 and smaller than square_length_m {self.square_length_m}"
            )
        return self

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary as manifests and calibration files hold it: `kind` is called "type" there."""
        described = self.model_dump(mode="json")
        return {"type": described.pop("kind"), **described}

    @property
    def is_ambiguous(self) -> bool:
        """True for a chessboard that looks the same after half a turn."""
        return self.kind == "chessboard" and (self.squares_x + self.squares_y) % 2 == 0

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(corners, 3) inner corners, or corners of tags, in the board frame [m]."""
        if self.kind == "tags":
            column, row = np.meshgrid(np.arange(self.squares_x), np.arange(self.squares_y))
            centres = (np.stack([column.ravel(), row.ravel()], -1) + 0.5) * self.square_length_m
            around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.marker_length_m / 2
            flat = (centres[:, None] + around).reshape(-1, 2)
            return np.asarray(np.column_stack([flat, np.zeros(len(flat))]), np.float64)
        x, y = np.meshgrid(np.arange(1, self.squares_x), np.arange(1, self.squares_y))
        return np.asarray(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], -1) * self.square_length_m, np.float64)
