"""Moves the arm to views of a trajectory, one at a time, or by small steps along the camera's axes, on checked paths."""

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.drivers.protocols import Robot
from koala3d.capture.model import kinematics
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Motion, Trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.planning.plan import connect
from koala3d.capture.planning.solutions import solve
from koala3d.capture.rig.moves import Moves
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError, nearest

Joints = NDArray[np.float64]

STEP_SPEED = 0.2
"""Of the fastest joint in a small step, which somebody watches from nearby [rad/s]."""
LARGEST_STEP = 0.5
"""A small step that would turn a joint by more leads past a singular pose [rad]."""


class Jog:
    """An arm that goes to views by name, from wherever it is."""

    def __init__(self, robot: Robot, trajectory: Trajectory, carrier: Carrier, moves: Moves | None = None) -> None:
        self.robot, self.trajectory, self.moves = robot, trajectory, moves or Moves()
        self.obstacles = Obstacles.of(trajectory, carrier)
        self.is_free = False

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
        self.free(False)
        self._along(self.path_to(name), self.trajectory.motion, f"view {name}")

    def step(self, shift: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Move the camera by (3,) `shift` [m] along its own axes (right, down, forward), and by (3,) `turn` about them [rad].

        Raises:
            UnreachableError: the arm cannot do it, or only by a large motion; nothing has moved.
            PlanningError: something is in the way; nothing has moved.
            CaptureError: as `Robot.move_to`.
        """
        self.free(False)
        motion = self.trajectory.motion
        slow = motion.model_copy(update={"speed": min(motion.speed, STEP_SPEED)})
        self._along(self.path_of(shift, turn), slow, "this step")

    def _along(self, path: list[Joints], motion: Motion, where: str) -> None:
        self.moves.along(self.robot, path, motion, self.obstacles, view=where)

    def path_of(self, shift: ArrayLike, turn: ArrayLike) -> list[Joints]:
        """Joint angles to pass through in a step. Arguments and errors as in `step`."""
        carrier, present = self.obstacles.carrier, self.robot.state().joints
        if carrier.beside is not None:
            raise UnreachableError("the camera stands beside the arm, which cannot move it", where=self.trajectory.name)
        moved = carrier.base_from_camera(present) @ pose.from_rotation_vector(turn, shift)
        found = carrier.arm.inverse(carrier.flange_for(moved))
        if len(found):
            found = kinematics.nearest_turn(found, present, carrier.arm.lower, carrier.arm.upper)
        steps = np.abs(found - present).max(axis=-1) if len(found) else np.array([np.inf])
        if steps.min() > LARGEST_STEP:
            turned = float(np.degrees(steps.min()))
            why = f"a joint would turn by {turned:.0f} degrees" if np.isfinite(turned) else "out of reach"
            raise UnreachableError("the arm cannot take this step", why=why, remedy="try a shorter one, or go to another view")
        goal = np.asarray(found[int(steps.argmin())], np.float64)
        if forbidden := carrier.forbidden(goal):
            raise UnreachableError("the arm cannot take this step", why=forbidden)
        return connect(present, goal, self.obstacles, where="this step")

    @property
    def can_be_freed(self) -> bool:
        """Whether the arm's client offers freedrive."""
        return hasattr(self.robot, "freedrive")

    def free(self, on: bool) -> None:
        """Let a person move the arm by hand, or hold it; the latter does nothing to an arm that is held."""
        if on != self.is_free:
            self.robot.freedrive(on)  # type: ignore[attr-defined]  # where it is offered, see `can_be_freed`
            self.is_free = on

    def stop(self) -> None:
        """Stop the arm, which also ends freedrive; any thread."""
        self.robot.stop()
        self.is_free = False
