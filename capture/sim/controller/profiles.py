"""Motions in joint space as functions of time: trapezoids of speed, as the controller's movej makes them, and stops.

Times in seconds from the start of the motion, angles in radians.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Joints = NDArray[np.float64]


class Profile(Protocol):
    """A motion that lasts `duration` [s]."""

    @property
    def duration(self) -> float:
        """Time until rest [s]."""
        ...

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`, held at the ends."""
        ...


def trapezoid_times(distance: float, speed: float, acceleration: float) -> tuple[float, float]:
    """(ramp, cruise) durations [s] of a motion over `distance` [rad] from rest to rest; it lasts 2 ramps + cruise."""
    if distance <= 0:
        return 0.0, 0.0
    ramp = min(speed / acceleration, (distance / acceleration) ** 0.5)
    return ramp, distance / (acceleration * ramp) - ramp


@dataclass(frozen=True)
class Move:
    """From rest at `start` to rest at `goal`, all joints in proportion; `speed` and `acceleration` are the fastest joint's."""

    start: Joints
    goal: Joints
    speed: float
    acceleration: float

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        ramp, cruise = self._times
        return 2 * ramp + cruise

    @property
    def _times(self) -> tuple[float, float]:
        return trapezoid_times(float(np.abs(self.goal - self.start).max()), self.speed, self.acceleration)

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        way = self.goal - self.start
        distance = float(np.abs(way).max())
        ramp, cruise = self._times
        left = 2 * ramp + cruise - time
        if distance == 0 or left <= 0 or time <= 0:
            return self.start if distance and time <= 0 else self.goal, np.zeros_like(self.start), np.zeros_like(self.start)
        if time < ramp:
            travelled, speed, acceleration = self.acceleration * time**2 / 2, self.acceleration * time, self.acceleration
        elif time <= ramp + cruise:
            speed, acceleration = self.acceleration * ramp, 0.0
            travelled = speed * (time - ramp / 2)
        else:
            speed, acceleration = self.acceleration * left, -self.acceleration
            travelled = distance - self.acceleration * left**2 / 2
        direction = way / distance
        return self.start + direction * travelled, direction * speed, direction * acceleration


@dataclass(frozen=True)
class Braking:
    """From `start` moving at `speeds` [rad/s] to rest, the fastest joint slowing down at `deceleration` [rad/s^2]."""

    start: Joints
    speeds: Joints
    deceleration: float

    @property
    def duration(self) -> float:
        """Until rest [s]."""
        return float(np.abs(self.speeds).max()) / self.deceleration

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        duration = self.duration
        time = min(max(time, 0.0), duration)
        if duration == 0 or time >= duration:
            return self.start + self.speeds * duration / 2, np.zeros_like(self.start), np.zeros_like(self.start)
        slowing = -self.speeds / duration
        return self.start + self.speeds * time + slowing * time**2 / 2, self.speeds + slowing * time, slowing


@dataclass(frozen=True)
class Chain:
    """One motion after another."""

    first: Profile
    second: Profile

    @property
    def duration(self) -> float:
        """Of both [s]."""
        return self.first.duration + self.second.duration

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        return self.first.at(time) if time < self.first.duration else self.second.at(time - self.first.duration)
