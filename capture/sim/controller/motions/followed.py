"""Motions that a client steers while they last: towards joints that it sends over and over, or at speeds that it sends."""

from dataclasses import dataclass

import numpy as np

from koala3d.capture.sim.controller.motions.profiles import Joints

SETTLED = 25.0  # time constants after which what is left is below 1e-9 of the way


@dataclass(frozen=True)
class Following:
    """Towards `target` as a critically damped spring pulls: exp(-rate t), from any angles and speeds.

    A target that moves evenly is followed 2 / rate seconds late.
    """

    start: Joints
    speeds: Joints
    target: Joints
    rate: float  # [1/s]

    @property
    def duration(self) -> float:
        """Until the target is reached [s]."""
        return SETTLED / self.rate

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        if time >= self.duration:
            return self.target, np.zeros_like(self.target), np.zeros_like(self.target)
        time, k = max(time, 0.0), self.rate
        away = self.start - self.target
        slope = self.speeds + k * away
        now, fading = away + slope * time, np.exp(-k * time)
        return self.target + now * fading, (slope - k * now) * fading, (k * k * now - 2 * k * slope) * fading


def following(start: Joints, speeds: Joints, target: Joints, delay: float, top_speeds: Joints) -> Following:
    """Towards a target that is followed `delay` seconds late, or later if a joint would turn faster than its highest speed."""
    rate = 2 / delay
    away = np.abs(target - start)
    if away.max() > 0:  # from rest the highest speed is rate * way / e
        rate = min(rate, float((np.e * top_speeds / np.maximum(away, 1e-12)).min()))
    return Following(start, speeds, target, rate)


@dataclass(frozen=True)
class JointDrift:
    """From angles and speeds evenly to other speeds, which are then kept until the motion is stopped.

    Args:
        first, last: (n,) speeds [rad/s].
        ramp: seconds in which the one become the other.
    """

    start: Joints
    first: Joints
    last: Joints
    ramp: float

    @property
    def duration(self) -> float:
        """Infinite, unless the last speeds are zero [s]."""
        return np.inf if self.last.any() else self.ramp

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        changing, kept = min(max(time, 0.0), self.ramp), max(time - self.ramp, 0.0)
        change = (self.last - self.first) / self.ramp if self.ramp > 0 else np.zeros_like(self.first)
        speeds = self.first + change * changing if time < self.ramp else self.last
        angles = self.start + (self.first + speeds) / 2 * changing + self.last * kept
        return angles, speeds, change if time < self.ramp else np.zeros_like(change)
