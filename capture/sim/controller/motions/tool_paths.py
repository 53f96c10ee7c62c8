"""Where the tool is as a function of time: along straight lines with rounded corners, or at a constant velocity."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sim.controller.motions.blends import Schedule, halves
from koala3d.capture.sim.controller.motions.profiles import Trapezoid
from koala3d.datasets import pose

Array = NDArray[np.float64]
LEVER_M = 0.2
"""A turn by 1 rad counts as this way, where the tool turns more than it moves: the speed of a tool is given in m/s only."""


class ToolPath(Protocol):
    """A motion of the tool centre point that lasts `duration` [s]."""

    @property
    def duration(self) -> float:
        """Time until rest [s]; infinite for a motion that goes on until it is stopped."""
        ...

    @property
    def kinks(self) -> Sequence[float]:
        """Times at which an acceleration changes, in order [s]."""
        ...

    def at(self, time: float) -> tuple[Array, Array]:
        """(4, 4) `base_from_tcp` [m], and its (6,) velocity in the base [m/s, rad/s]."""
        ...


@dataclass(frozen=True)
class Lines:
    """From rest along straight lines to rest; the orientation turns about one axis on each.

    Args:
        poses: (k + 1, 4, 4) `base_from_tcp` [m]: where it starts, and k waypoints.
        schedule: of k legs, whose distances are `lengths` of the poses [m].
    """

    poses: Array
    schedule: Schedule

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.schedule.duration

    @property
    def kinks(self) -> Sequence[float]:
        """Times at which an acceleration changes [s]."""
        return self.schedule.kinks

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """(k, 3) ways in the base [m] and turns [rad] in the tool's own axes at the start of each leg."""
        before, after = self.poses[:-1, :3, :3], self.poses[1:, :3, :3]
        return np.diff(self.poses[:, :3, 3], axis=0), pose.rotation_vector(np.swapaxes(before, 1, 2) @ after)

    def at(self, time: float) -> tuple[Array, Array]:
        """(4, 4) `base_from_tcp` [m], and its (6,) velocity in the base [m/s, rad/s]."""
        ways, turns = self._steps
        position, rotation, velocity = self.poses[0, :3, 3].copy(), self.poses[0, :3, :3], np.zeros(6)
        for leg, (covered, speed, _), way, turn in zip(self.schedule.legs, self.schedule.at(time), ways, turns, strict=True):
            share, rate = (covered / leg.distance, speed / leg.distance) if leg.distance > 0 else (1.0, 0.0)
            position += share * way
            velocity += rate * np.concatenate([way, rotation @ turn])
            if share > 0:
                rotation = rotation @ pose.from_rotation_vector(share * turn)[:3, :3]
        return pose.rigid(rotation, position), velocity


def lines(poses: Array, speeds: Sequence[float], accelerations: Sequence[float], radii: Sequence[float]) -> Lines:
    """Straight lines from the first of (k + 1, 4, 4) poses through the k others.

    Args:
        speeds, accelerations: of each leg [m/s, m/s^2].
        radii: around each waypoint, within which the path may be rounded [m]; that of the last one is not used.
    """
    lengths = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1)
    turns = pose.rotation_angle(np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3])
    distances = np.maximum(lengths, LEVER_M * turns).tolist()
    legs = tuple(Trapezoid(*leg) for leg in zip(distances, speeds, accelerations, strict=True))
    shares = [radius / length if length > 0 else 0.0 for radius, length in zip(radii, lengths, strict=True)]
    after = [radius / length if length > 0 else 0.0 for radius, length in zip(radii[:-1], lengths[1:], strict=True)]
    return Lines(poses, Schedule(legs, halves(distances, list(zip(shares, [*after, 0.0], strict=True)))))


@dataclass(frozen=True)
class Drift:
    """From a pose and a velocity evenly to another velocity, which is then kept until the motion is stopped.

    Args:
        begin: (4, 4) `base_from_tcp` at the start [m].
        first, last: (6,) velocities in the base [m/s, rad/s].
        ramp: seconds in which the one becomes the other.
    """

    begin: Array
    first: Array
    last: Array
    ramp: float

    @property
    def duration(self) -> float:
        """Infinite, unless the last velocity is zero [s]."""
        return np.inf if self.last.any() else self.ramp

    @property
    def kinks(self) -> Sequence[float]:
        """Times at which an acceleration changes [s]."""
        return [0.0, self.ramp]

    def at(self, time: float) -> tuple[Array, Array]:
        """(4, 4) `base_from_tcp` [m], and its (6,) velocity in the base [m/s, rad/s]."""
        changing, kept = min(time, self.ramp), max(time - self.ramp, 0.0)
        share = changing / self.ramp if self.ramp > 0 else 1.0
        way = self.first * changing + (self.last - self.first) * share * changing / 2
        turned = pose.from_rotation_vector(kept * self.last[3:]) @ pose.from_rotation_vector(way[3:])
        place = pose.rigid(turned[:3, :3] @ self.begin[:3, :3], self.begin[:3, 3] + way[:3] + kept * self.last[:3])
        return place, self.first + share * (self.last - self.first)
