"""Angles of a turntable for the views of a trajectory."""

from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from koala3d.datasets.core.schema import Schema

Interval = tuple[float, float]


class Turning(Schema):
    """The angles at which the views of a group are taken: `angles_deg`, or `steps` that divide `range_deg` evenly."""

    steps: int | None = Field(default=None, ge=1, le=10_000, description="number of angles, evenly spaced")
    range_deg: Interval = Field(default=(0.0, 360.0), description="from the first angle up to, but without, the last [degrees]")
    angles_deg: list[float] | None = Field(default=None, min_length=1, description="the angles themselves [degrees]")
    take: Literal["each", "pairs"] = Field(
        default="each",
        description="each: every view at every angle, the arm stands still while the table turns; "
        "pairs: the first view at the first angle, the second at the second, and so on",
    )
    shift_deg: float = Field(
        default=0.0, ge=-360, le=360, description="each: added from every view to the next, so that rings are staggered [degrees]"
    )

    @model_validator(mode="after")
    def _stated_once(self) -> Self:
        if (self.steps is None) == (self.angles_deg is None):
            raise ValueError("give either steps or angles_deg")
        if self.shift_deg and self.take == "pairs":
            raise ValueError("shift_deg is for take: each; with pairs every view has its own angle")
        return self

    @property
    def angles(self) -> list[float]:
        """The angles [rad]."""
        if self.angles_deg is not None:
            return np.radians(self.angles_deg).tolist()
        first, last = np.radians(self.range_deg)
        return np.linspace(first, last, self.steps or 1, endpoint=False).tolist()

    def complaint(self, views: int) -> str:
        """What is wrong with these angles for a group of so many views; empty: nothing."""
        number = len(self.angles)
        if self.take == "pairs" and number != views:
            return f"turntable has {number} angles for {views} views; with take: pairs there is one for each"
        return ""

    def taken(self, views: int) -> list[tuple[int, float]]:
        """Index of a view and angle of the table [rad], in the order of capture; the table turns to and fro."""
        angles = self.angles
        if self.take == "pairs":
            return list(enumerate(angles))
        order = [angles, angles[::-1]]
        return [(view, angle + view * float(np.radians(self.shift_deg))) for view in range(views) for angle in order[view % 2]]
