"""Motions along several straight legs, rounded where two legs meet.

Each leg is a trapezoid of speed from rest to rest. The next one begins while the one before still slows down, and the two add
up: where both change their speed evenly, the path is a parabola (linear segments with parabolic blends; Craig, "Introduction to
Robotics", 7.3). A blend begins and ends within its radius; outside of it the legs stay straight. A blend covers at most half of
a leg, and no more than the ramps of its speed, so that blends never meet.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from koala3d.capture.sim.controller.motions.profiles import Joints, Trapezoid


@dataclass(frozen=True)
class Schedule:
    """When the legs begin, and how far each has come.

    Args:
        legs: one or more.
        blends: for each leg, from which remaining distance on the next leg may begin, in the units of the two legs:
            (distance left on this leg, distance covered on the next one). The last entry is not used.
    """

    legs: tuple[Trapezoid, ...]
    blends: tuple[tuple[float, float], ...]

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """When each leg begins [s]."""
        starts = [0.0]
        for (before, after), (left, covered) in zip(pairwise(self.legs), self.blends, strict=False):
            shared = min(before.times[0], after.times[0], _ramp_time(left, before), _ramp_time(covered, after))
            starts.append(starts[-1] + before.duration - shared)
        return tuple(starts)

    @property
    def duration(self) -> float:
        """Until the end of the last leg [s]."""
        return max(start + leg.duration for start, leg in zip(self.starts, self.legs, strict=True))

    @cached_property
    def kinks(self) -> list[float]:
        """Times at which an acceleration changes, in order [s]."""
        found = {0.0, self.duration}
        for start, leg in zip(self.starts, self.legs, strict=True):
            ramp, cruise = leg.times
            found |= {start, start + ramp, start + ramp + cruise, start + leg.duration}
        return sorted(found)

    def at(self, time: float) -> list[tuple[float, float, float]]:
        """Of each leg: distance covered, speed and acceleration."""
        return [leg.at(time - start) for start, leg in zip(self.starts, self.legs, strict=True)]


def _ramp_time(distance: float, leg: Trapezoid) -> float:
    """Seconds in which a leg covers a distance from rest, as far as its ramp goes."""
    return float(np.sqrt(2 * distance / leg.acceleration))


@dataclass(frozen=True)
class JointPath:
    """From rest along straight lines between joint angles to rest.

    Args:
        points: (k + 1, n) angles: where it starts, and k waypoints.
        schedule: of k legs, whose distances are those of the joint that has to turn farthest [rad].
    """

    points: Joints
    schedule: Schedule

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.schedule.duration

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        if time >= self.duration:
            return self.points[-1], np.zeros_like(self.points[0]), np.zeros_like(self.points[0])
        shares = np.zeros((3, len(self.schedule.legs)))
        for number, (leg, along) in enumerate(zip(self.schedule.legs, self.schedule.at(time), strict=True)):
            shares[:, number] = np.array(along) / leg.distance if leg.distance > 0 else (1.0, 0.0, 0.0)
        angles, speeds, accelerations = shares @ np.diff(self.points, axis=0)
        return self.points[0] + angles, speeds, accelerations


def turning(points: Joints) -> list[float]:
    """Distance of each leg between (k + 1, n) angles: that of the joint that turns farthest [rad]."""
    return np.abs(np.diff(points, axis=0)).max(axis=1).tolist()


def halves(distances: Sequence[float], reached: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Blends that cover no more than half of a leg.

    Args:
        reached: for each waypoint, how far its radius goes on the leg before and on the one after it, in shares of the legs.
    """
    limited = []
    for number, (left, covered) in enumerate(reached):
        after = distances[number + 1] if number + 1 < len(distances) else 0.0
        limited.append((min(left, 0.5) * distances[number], min(covered, 0.5) * after))
    return tuple(limited)
