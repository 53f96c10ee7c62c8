"""Moves an arm along planned paths: slowly at first and after a fault, and if a person wants it, only after asking."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import StopLatched
from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model.trajectory import Motion
from koala3d.capture.planning import FIRST_RAD_S, Obstacles, Pace
from koala3d.capture.planning.paths import least_margin

Joints = NDArray[np.float64]


@dataclass(frozen=True)
class NextMove:
    """A move that is about to begin: to one view, through all corners of its path."""

    view: str
    corners: list[Joints]
    """Joint angles [rad], the first being the present ones."""
    paces: list[Pace]
    obstacles: Obstacles

    @property
    def seconds(self) -> float:
        """How long it takes without settling."""
        return sum(pace.seconds for pace in self.paces)

    @property
    def words(self) -> str:
        """The move for a person: how far each joint goes, how fast, how near to anything."""
        ways = np.degrees(np.abs(np.diff(self.corners, axis=0)).sum(axis=0))
        joints = ", ".join(f"joint {number} by {way:.0f}" for number, way in enumerate(ways, 1) if way >= 0.5)
        speed, point = max(pace.speed for pace in self.paces), max(pace.point_speed for pace in self.paces)
        room = least_margin(np.array(self.corners), self.obstacles) + self.obstacles.clearance_m
        return (
            f"{self.view}: {joints or 'no joint'} degrees, at most {speed:.2f} rad/s and {point:.2f} m/s, {self.seconds:.0f} s, "
            f"{1e3 * room:.0f} mm from the nearest thing"
        )


@dataclass
class Moves:
    """The moves of one connected arm. The first one after a start, a stop or a fault has at most `FIRST_RAD_S`.

    Args:
        slow: factor of every speed and acceleration.
        ask: is asked before each move; False ends the session with the arm at rest.
        say: tells a person what the first move will be.
    """

    slow: float = 1.0
    ask: Callable[[NextMove], bool] | None = None
    say: Callable[[str], None] = lambda words: None
    _first: bool = field(default=True, init=False)

    def along(self, robot: Robot, path: list[Joints], motion: Motion, obstacles: Obstacles, *, view: str) -> None:
        """Move through (n,) joint angles, and return when the arm has settled at the last ones.

        Raises StopLatched: a person does not want the move, and nothing has moved; and what `Robot.move_to` raises.
        """
        corners = [robot.state().joints, *path]
        limit = FIRST_RAD_S if self._first else np.inf
        ends = zip(corners[:-1], path, strict=True)
        paces = [Pace.of(*one, motion, obstacles.carrier, slow=self.slow, limit=limit) for one in ends]
        move = NextMove(view, corners, paces, obstacles)
        if self._first:
            self.say(f"first move, to {view}: no joint faster than {FIRST_RAD_S:g} rad/s, about {move.seconds:.0f} s")
        if self.ask is not None and not self.ask(move):
            remedy = "the same command with --resume continues a recording"
            raise StopLatched("ended at the terminal, the arm stands still", where=f"before {view}", remedy=remedy)
        self._first = True
        for joints, pace in zip(path, paces, strict=True):
            robot.move_to(joints, speed=pace.speed, acceleration=pace.acceleration)
        self._first = False
