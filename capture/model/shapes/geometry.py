"""Points, poses and boxes as a person writes them in trajectory and rig files."""

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from koala3d.datasets import pose
from koala3d.datasets.core.schema import Schema

Vector = tuple[float, float, float]


class PoseDescription(Schema):
    """A rigid transform a_from_b as position and rotation vector."""

    position: Vector = Field(default=(0, 0, 0), description="origin of b in a [m]")
    rotation_deg: Vector = Field(default=(0, 0, 0), description="rotation vector: axis times angle [degrees]")

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) transform [m]."""
        return pose.from_rotation_vector(np.radians(self.rotation_deg), self.position)


class BoardPlace(Schema):
    """Where a calibration target is: axes x along its squares_x, y along its squares_y, z into the board."""

    position: Vector = Field(default=(0, 0, 0), description="of the target's first corner or middle, see `at` [m]")
    rotation_deg: Vector = Field(default=(0, 0, 0), description="rotation vector: axis times angle [degrees]")
    at: Literal["corner", "middle"] = Field(default="corner", description="what position is that of: first corner or middle")

    def matrix(self, size: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) pose [m] of the board frame of a target of (2,) `size` [m]."""
        placed = pose.from_rotation_vector(np.radians(self.rotation_deg), self.position)
        return placed if self.at == "corner" else placed @ pose.rigid(np.eye(3), [*(-np.asarray(size) / 2), 0.0])


class Box(Schema):
    """A box aligned with the axes of the base frame."""

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
