"""Poses of a target in all views, with or without the camera, by least squares in pixels without an arm.

This is the problem of Zhang (2000), section 3.3, solved by Levenberg-Marquardt with analytic derivatives.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.arrays import Array, Indices
from calib.errors import CalibrationError
from calib.intrinsics import projection
from calib.solver.elimination import Eliminated, eliminate
from calib.solver.geometry import by_motion, rotate
from calib.solver.levenberg_marquardt import Limits, minimise
from datasets import pose


@dataclass(frozen=True)
class Bundle:
    """The solution."""

    intrinsics: Array  # (12,) in the order of `projection.NAMES`
    camera_from_board: Array  # (views, 4, 4)
    residuals: Array  # (n, 2) seen minus predicted [px]
    information: Array  # (p, p) of the free intrinsics for corners of unit deviation, poses eliminated [1 / px^2]


LIMITS = Limits(max_steps=30, tolerance=1e-10, least_cost=1e-8, rounding=1e-12, max_damping=2e7)


class Corners(NamedTuple):
    """The corners of all views in one list."""

    view: Indices  # (n,) ascending
    pixels: Array  # (n, 2) where they are seen [px]
    points: Array  # (n, 3) on the board [m]


def fit(
    corners: Corners, intrinsics: Array, camera_from_board: Array, free: tuple[str, ...] = (), fisheye: bool = False
) -> Bundle:
    """Minimise the distance of seen and predicted corners. Raises CalibrationError where a board starts behind the camera.

    The search starts from (12,) `intrinsics`, of which those of `free` are estimated, and from (views, 4, 4) poses.
    """
    problem = _Problem(corners, [projection.NAMES.index(name) for name in free], fisheye)
    found, _ = minimise(_Point(problem, intrinsics, camera_from_board), LIMITS)
    return Bundle(found.intrinsics, found.camera_from_board, found.residuals, found.system.information)


class _Problem(NamedTuple):
    """What stays the same during a fit."""

    corners: Corners
    columns: list[int]
    fisheye: bool


class _Point:
    """A camera and poses, with residuals and the linear problem about them; poses are perturbed from the left."""

    def __init__(self, problem: _Problem, intrinsics: Array, camera_from_board: Array) -> None:
        self.problem, self.intrinsics, self.camera_from_board = problem, intrinsics, camera_from_board
        corners = problem.corners
        rotations, translations = camera_from_board[corners.view, :3, :3], camera_from_board[corners.view, :3, 3]
        in_camera = rotate(rotations, corners.points) + translations
        if not in_camera[:, 2].min() > 1e-6:
            raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")
        predicted, by_camera, by_intrinsics = projection.project(in_camera, intrinsics, problem.fisheye)
        self.residuals = corners.pixels - predicted
        self.cost = float((self.residuals**2).sum())
        self._rows = by_motion(by_camera, in_camera), by_intrinsics[..., problem.columns], self.residuals[..., None]

    @cached_property
    def system(self) -> Eliminated:
        """The linear problem."""
        own, of_camera = np.zeros((len(self.camera_from_board), 6, 7)), np.zeros((0, len(self.problem.columns) + 1))
        return eliminate(self.problem.corners.view, np.concatenate(self._rows, -1), own, of_camera)

    def stepped(self, damping: float) -> "_Point":
        """The point after one damped step."""
        step, twists = self.system.step(damping)
        intrinsics = self.intrinsics.copy()
        intrinsics[self.problem.columns] += step
        moved = pose.from_rotation_vector(twists[:, 3:], twists[:, :3]) @ self.camera_from_board
        return _Point(self.problem, intrinsics, moved)
