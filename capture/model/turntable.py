"""What a rig file says of a turntable."""

from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from koala3d.capture.model.shapes.geometry import PoseDescription
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema
from koala3d.datasets.turntable import Axis


class TurntableDescription(Schema):
    """A table that turns the object: where it stands, how far and how fast it turns, and what drives it."""

    base_from_turntable: PoseDescription = Field(
        description="nominal pose of the table, whose z axis is the axis of rotation: its origin is on the axis. "
        "1 cm and 2 degrees are enough: 'calib turntable' finds the true axis"
    )
    driver: Literal["grbl"] = Field(default="grbl", description="what drives it: grbl, a stepper controller with Grbl 1.1")
    address: str = Field(
        default="/dev/ttyUSB0", min_length=1, description="serial port, or host:port of a network connection to one"
    )
    baud: int = Field(default=115_200, ge=1200, le=4_000_000, description="bits per second of a serial port")
    letter: Literal["X", "Y", "Z"] = Field(default="X", description="the controller's axis that turns the table")
    units_per_turn: float = Field(default=360.0, gt=0, le=1e6, description="of that axis; 360: its units are degrees")
    reversed: bool = Field(default=False, description="whether positive units turn it clockwise, seen from above the axis")
    homing: bool = Field(
        default=False, description="whether a homing switch gives the zero; else it is where the table stands at power-up"
    )
    min_deg: float = Field(default=-3600.0, ge=-360_000, description="smallest angle [degrees]")
    max_deg: float = Field(default=3600.0, le=360_000, description="largest angle [degrees]")
    max_speed: float = Field(default=0.5, gt=0, le=20, description="speed [rad/s]")
    settle_time_s: float = Field(default=0.5, ge=0, le=60, description="how long it swings after a motion [s]")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.min_deg < self.max_deg:
            raise ValueError(f"min_deg {self.min_deg:g} is not below max_deg {self.max_deg:g}")
        return self

    @property
    def axis(self) -> Axis:
        """The nominal axis."""
        return Axis.of(self.base_from_turntable.matrix())

    def outside(self, angle: float) -> str:
        """Which limit an angle [rad] violates, in words; empty: none."""
        degrees = float(np.degrees(angle))
        if self.min_deg - 1e-9 <= degrees <= self.max_deg + 1e-9:
            return ""
        return f"turntable angle {degrees:.1f} degrees, limits {self.min_deg:g} to {self.max_deg:g}"

    def duration(self, travel: float) -> float:
        """Time [s] of a turn by `travel` [rad], settling included; 0 for none."""
        return 0.0 if abs(travel) < 1e-9 else abs(travel) / self.max_speed + self.settle_time_s

    def swept(self, corners: ArrayLike) -> NDArray[np.float64]:
        """(2, 3) corners [m] of the box, aligned with the base, that holds a box at every angle of an upright axis.

        Args:
            corners: (2, 3) of the box with the table at angle zero.
        """
        low, high = np.asarray(corners, np.float64)
        x, y = self.axis.point[:2]
        reach = np.hypot(max(abs(low[0] - x), abs(high[0] - x)), max(abs(low[1] - y), abs(high[1] - y)))
        return np.array([[x - reach, y - reach, low[2]], [x + reach, y + reach, high[2]]])


def required(table: TurntableDescription | None, trajectory: str) -> TurntableDescription:
    """The turntable of a rig for a trajectory whose views turn it; raises UsageError where the rig has none."""
    if table is None:
        remedy = "describe one under 'turntable' in the rig file, or choose a rig that has one"
        raise UsageError("the rig has no turntable", where=trajectory, why="its views turn one", remedy=remedy)
    return table


class LampOutput(Schema):
    """What switches a lamp."""

    output: int = Field(ge=0, le=7, description="standard digital output of the arm's controller, to which its relay is wired")


class LampDescription(Schema):
    """A lamp, and what it stands on."""

    name: str = Field(min_length=1, max_length=100, description="what a person calls it")
    stands: Literal["room", "flange", "turntable"] = Field(
        default="room", description="where it is fixed: in the room, on the flange beside the camera, or on the turntable"
    )
