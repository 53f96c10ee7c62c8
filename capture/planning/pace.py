"""How fast each straight move is: as the trajectory says, unless the body's fastest point would be too fast."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Motion
from koala3d.capture.planning.swept import lever

Joints = NDArray[np.float64]

FIRST_RAD_S = 0.1
"""Speed of the fastest joint on the way to the first view after a start or a fault: time enough to reach a stop button."""


@dataclass(frozen=True)
class Pace:
    """Speed and acceleration of one move, of the joint that moves farthest: the others keep in step."""

    travel: float
    """Of that joint [rad]."""
    speed: float
    """Its highest speed [rad/s]."""
    acceleration: float
    """[rad/s^2]."""
    lever: float = 0.0
    """Speed of the body's fastest point for each rad/s of that joint [m]."""

    @classmethod
    def of(
        cls, start: Joints, goal: Joints, motion: Motion, carrier: Carrier, *, slow: float = 1.0, limit: float = np.inf
    ) -> "Pace":
        """That of a move from (n,) to (n,) joint angles.

        Args:
            motion: speed and acceleration that are asked for.
            carrier: its `max_tool_speed` holds at the plateau, and so everywhere.
            slow: factor by which everything is slowed down.
            limit: of the fastest joint [rad/s].
        """
        long = lever(start, goal, carrier)
        allowed = min(motion.speed, carrier.max_tool_speed / long) if long > 0 else motion.speed
        travel = float(np.abs(np.subtract(goal, start)).max())
        return cls(travel, min(slow * allowed, limit), slow * motion.acceleration, long)

    @property
    def seconds(self) -> float:
        """Time of the move with a trapezoidal speed profile."""
        ramp = self.speed**2 / self.acceleration
        short = self.travel < ramp
        return float(2 * np.sqrt(self.travel / self.acceleration) if short else (self.travel + ramp) / self.speed)

    @property
    def point_speed(self) -> float:
        """Speed that the fastest point of the body does not exceed [m/s]; a short move does not reach its full speed."""
        return self.lever * min(self.speed, float(np.sqrt(self.travel * self.acceleration)))


def move_duration(motion: Motion, travel: float) -> float:
    """Time [s] of a move of the fastest joint by `travel` [rad] at the speed of the trajectory, if the body may be so fast."""
    return Pace(travel, motion.speed, motion.acceleration).seconds


def paces(corners: Sequence[Joints], motion: Motion, carrier: Carrier) -> list[Pace]:
    """Of the moves through (n,) joint angles, one after the other."""
    return [Pace.of(start, goal, motion, carrier) for start, goal in pairwise(corners)]
