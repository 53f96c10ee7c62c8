"""Moves the arm to views of a trajectory, one at a time, along planned and checked paths."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.planning.plan import connect
from koala3d.capture.planning.solutions import solve
from koala3d.capture.rig.moves import Moves
from koala3d.datasets.core.errors import UsageError, nearest

Joints = NDArray[np.float64]


class Jog:
    """An arm that goes to views by name, from wherever it is."""

    def __init__(self, robot: Robot, trajectory: Trajectory, carrier: Carrier, moves: Moves | None = None) -> None:
        self.robot, self.trajectory, self.moves = robot, trajectory, moves or Moves()
        self.obstacles = Obstacles.of(trajectory, carrier)

    @cached_property
    def views(self) -> dict[str, Viewpoint]:
        """The views of the trajectory by name."""
        return {view.name: view for view in self.trajectory.viewpoints()}

    def path_to(self, name: str) -> list[Joints]:
        """Joint angles to pass through from the present ones, the last being those that take the view: the nearest that do.

        Raises:
            UsageError: there is no such view.
            UnreachableError: the arm cannot take it.
            PlanningError: no path leads to it.
        """
        if name not in self.views:
            raise UsageError(f"there is no view '{name}'", where=self.trajectory.name, remedy=nearest(name, list(self.views)))
        found, present = solve(self.views[name], self.obstacles), self.robot.state().joints
        if found.reason:
            raise UnreachableError(f"view {name} cannot be taken", where=self.trajectory.name, why=found.reason)
        goal = found.joints[int(np.abs(found.joints - present).max(-1).argmin())]
        return connect(present, goal, self.obstacles, where=f"view {name}")

    def go(self, name: str) -> None:
        """Move to a view; returns when the arm has settled. Errors as in `path_to`, and those of `Robot.move_to`."""
        self.moves.along(self.robot, self.path_to(name), self.trajectory.motion, self.obstacles, view=f"view {name}")
