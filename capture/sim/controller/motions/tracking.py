"""Joints that follow a path of the tool."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model import kinematics
from koala3d.capture.model.kinematics import Joints, Links
from koala3d.capture.sim.controller.motions.tool_paths import ToolPath

Array = NDArray[np.float64]
SPACING_M = 0.02
"""Way of the tool between two places at which the joints are solved; in between they are cubics, which miss by less than 1 um."""
SHORTEST_S, LONGEST_S = 1e-3, 0.25  # between two such places, however fast or slow the motion is
PARTS = 4  # of every stretch between two changes of the acceleration, at least
CONVERGED = 1e-10  # [m, rad]
LEAP_RAD = 0.3
"""A joint that turns more than this between two places, which are centimetres apart, is at a singularity."""


class Unreachable(Exception):
    """The tool cannot go there."""


@dataclass(frozen=True)
class Tool:
    """What brings the tool where it is: the arm's true links, the active offset, and the highest speeds of its joints."""

    links: Links
    flange_from_tcp: Array
    top_speeds: Joints

    def place(self, joints: Joints) -> Array:
        """(4, 4) `base_from_tcp` [m] at (n,) angles."""
        return kinematics.forward(joints, self.links) @ self.flange_from_tcp

    def velocity(self, joints: Joints, speeds: Joints) -> Array:
        """(6,) velocity of the tool in the base [m/s, rad/s]."""
        return np.asarray(self._sweep(joints)[1] @ speeds)

    def speeds(self, joints: Joints, velocity: Array) -> Joints:
        """(n,) joint speeds that give the tool a velocity in the base [rad/s]."""
        return _solved(self._sweep(joints)[1], velocity)

    def solve(self, base_from_tcp: Array, near: Joints) -> Joints:
        """(n,) angles next to `near` that bring the tool there. Raises Unreachable: there are none."""
        joints = near
        for _ in range(12):
            reached, jacobian = self._sweep(joints)
            miss = np.concatenate([base_from_tcp[:3, 3] - reached[:3, 3], _turn(base_from_tcp, reached)])
            if np.abs(miss).max() < CONVERGED:
                return joints
            joints = joints + _solved(jacobian, miss)
            if np.abs(joints - near).max() > LEAP_RAD:
                break
        raise Unreachable("the tool's path leads out of reach or through a singularity")

    def _sweep(self, joints: Joints) -> tuple[Array, Array]:
        """(4, 4) `base_from_tcp` [m], and the (6, n) velocity of the tool per joint speed."""
        frames = kinematics.link_frames(joints, self.links)
        place = frames[-1] @ self.flange_from_tcp
        x, y, z = frames[:-1, :3, 2].T
        along, across, up = place[:3, 3, None] - frames[:-1, :3, 3].T
        return place, np.stack([y * up - z * across, z * along - x * up, x * across - y * along, x, y, z])


def _turn(wanted: Array, reached: Array) -> Array:
    """(3,) rotation vector of a small turn between two poses in the base [rad]; that of a large one is too short."""
    turn = wanted[:3, :3] @ reached[:3, :3].T
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2


def _solved(jacobian: Array, wanted: Array) -> Joints:
    try:
        return np.asarray(np.linalg.solve(jacobian, wanted), np.float64)
    except np.linalg.LinAlgError:  # exactly at a singularity
        return np.asarray(np.linalg.lstsq(jacobian, wanted, rcond=1e-9)[0], np.float64)


class Tracked:
    """Joints along a path of the tool, solved at places along it as time goes by.

    Where the path leads out of reach, through a singularity, or faster than the joints turn, it cannot be followed: `fault` is
    the time of the last place before [s], and the joints are held there with their speeds.

    Args:
        start: (n,) angles at the beginning of the path.
    """

    def __init__(self, path: ToolPath, tool: Tool, start: Joints) -> None:
        self.path, self.tool, self.fault = path, tool, np.inf
        self._times, self._angles = [0.0], [np.asarray(start, np.float64)]
        self._speeds = [tool.speeds(self._angles[0], path.at(0.0)[1])]

    @property
    def duration(self) -> float:
        """Time until rest [s]."""
        return self.path.duration

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        time = max(time, 0.0)
        self.solve_until(time)
        if time >= min(self.duration, self._times[-1]):
            rest = np.zeros_like(self._angles[0])
            return self._angles[-1], rest if time >= self.duration else self._speeds[-1], rest
        last = bisect_right(self._times, time)
        step = self._times[last] - self._times[last - 1]
        share = (time - self._times[last - 1]) / step
        return _cubic(share, step, *self._angles[last - 1 : last + 1], *self._speeds[last - 1 : last + 1])

    def solve_until(self, time: float) -> None:
        """Solve the joints up to a time [s], or up to the fault."""
        while self._times[-1] < min(time, self.duration) and np.isinf(self.fault):
            now, angles, speeds = self._times[-1], self._angles[-1], self._speeds[-1]
            later = self._next(now)
            place, velocity = self.path.at(later)
            try:
                found = self.tool.solve(place, angles + speeds * (later - now))
                if np.abs(found - angles).max() > LEAP_RAD:
                    raise Unreachable("a singularity")
            except Unreachable:
                self.fault = now
                return
            self._times.append(later)
            self._angles.append(found)
            self._speeds.append(self.tool.speeds(found, velocity))
            if (np.abs(self._speeds[-1]) > self.tool.top_speeds).any() and np.isinf(self.duration):
                self.fault = later

    @property
    def fastest(self) -> float:
        """Largest speed of a joint so far, as a multiple of its highest one."""
        return float((np.abs(self._speeds) / self.tool.top_speeds).max())

    def _next(self, now: float) -> float:
        """Time of the next place [s]."""
        kinks = self.path.kinks
        ahead = bisect_right(kinks, now)
        before = kinks[ahead - 1] if ahead else 0.0
        end = kinks[ahead] if ahead < len(kinks) else np.inf
        velocity = self.path.at(now)[1]
        way = float(np.linalg.norm(velocity[:3]) + np.linalg.norm(velocity[3:]) / 4)
        step = min(SPACING_M / max(way, 1e-9), LONGEST_S)
        if np.isfinite(end):
            step = min(step, (end - before) / PARTS)
        step = max(step, SHORTEST_S)  # two changes of the acceleration may be as good as one
        return end if now + 1.5 * step >= end else now + step


def _cubic(
    share: float, step: float, first: Joints, last: Joints, slope: Joints, end_slope: Joints
) -> tuple[Joints, Joints, Joints]:
    """Angles, speeds and accelerations at a share of `step` [s] between two angles with their speeds (Hermite's cubic)."""
    way, begin, end = last - first, slope * step, end_slope * step
    square, cube = 3 * way - 2 * begin - end, begin + end - 2 * way
    angles = first + share * (begin + share * (square + share * cube))
    speeds = (begin + share * (2 * square + 3 * share * cube)) / step
    return angles, speeds, (2 * square + 6 * share * cube) / step**2


@dataclass(frozen=True)
class Stretched:
    """A motion that takes `factor` times as long."""

    motion: Tracked
    factor: float

    @property
    def duration(self) -> float:
        """Until rest [s]."""
        return self.motion.duration * self.factor

    def at(self, time: float) -> tuple[Joints, Joints, Joints]:
        """(n,) angles, speeds and accelerations at `time`."""
        angles, speeds, accelerations = self.motion.at(time / self.factor)
        return angles, speeds / self.factor, accelerations / self.factor**2
