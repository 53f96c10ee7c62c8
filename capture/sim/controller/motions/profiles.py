"""Motions in joint space as functions of time: trapezoids of speed, as the controller's movej makes them, and stops.

Times in seconds from the start of the motion, angles in radians.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Joints = NDArray[np.float64]


class Profile(Protocol):
    """A motion that lasts `duration` [s]."""

    @property
    def duration(self) -> float:
        """Time until rest [s]; infinite for a motion that goes on until it is stopped."""
        ...

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`, held at the ends."""
        ...


def end_of(profile: Profile) -> Joints:
    """(n,) angles at which a motion ends; those of its start if it has no end."""
    return profile.at(profile.duration if np.isfinite(profile.duration) else 0.0)[0]


def trapezoid_times(distance: float, speed: float, acceleration: float) -> tuple[float, float]:
    """(ramp, cruise) durations [s] of a motion over `distance` [rad] from rest to rest; it lasts 2 ramps + cruise."""
    if distance <= 0:
        return 0.0, 0.0
    ramp = min(speed / acceleration, (distance / acceleration) ** 0.5)
    return ramp, distance / (acceleration * ramp) - ramp


@dataclass(frozen=True)
class Trapezoid:
    """How far a motion over `distance` from rest to rest has come. Distances in any unit, say metres; speeds in it per second."""

    distance: float
    speed: float
    acceleration: float

    @cached_property
    def times(self) -> tuple[float, float]:
        """(ramp, cruise) durations [s]."""
        return trapezoid_times(self.distance, self.speed, self.acceleration)

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        ramp, cruise = self.times
        return 2 * ramp + cruise

    def at(self, time: float) -> tuple[float, float, float]:
        """Distance covered, speed and acceleration at `time`, held at the ends."""
        ramp, cruise = self.times
        left = 2 * ramp + cruise - time
        if self.distance <= 0 or left <= 0 or time <= 0:
            return (self.distance if left <= 0 else 0.0), 0.0, 0.0
        if time < ramp:
            return self.acceleration * time**2 / 2, self.acceleration * time, self.acceleration
        if time <= ramp + cruise:
            top = self.acceleration * ramp
            return top * (time - ramp / 2), top, 0.0
        return self.distance - self.acceleration * left**2 / 2, self.acceleration * left, -self.acceleration


@dataclass(frozen=True)
class Move:
    """From rest at `start` to rest at `goal`, all joints in proportion; `speed` and `acceleration` are the fastest joint's."""

    start: Joints
    goal: Joints
    speed: float
    acceleration: float

    @cached_property
    def _way(self) -> Trapezoid:
        return Trapezoid(float(np.abs(self.goal - self.start).max()), self.speed, self.acceleration)

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self._way.duration

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        if time >= self.duration:
            return self.goal, np.zeros_like(self.start), np.zeros_like(self.start)
        travelled, speed, acceleration = self._way.at(time)
        direction = (self.goal - self.start) / self._way.distance
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
class Slowing:
    """A motion that comes to rest on its own path, evenly within `duration` [s].

    Args:
        motion: which is left at its time `phase` [s], where it runs at `rate` seconds of its own per second.
    """

    motion: Profile
    phase: float
    rate: float
    duration: float

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        time = min(max(time, 0.0), self.duration)
        left = 1 - time / self.duration if self.duration > 0 else 0.0
        angles, speeds, accelerations = self.motion.at(self.phase + self.rate * time * (1 + left) / 2)
        if left <= 0:
            return angles, np.zeros_like(angles), np.zeros_like(angles)
        rate = self.rate * left
        return angles, rate * speeds, rate**2 * accelerations - self.rate / self.duration * speeds


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
