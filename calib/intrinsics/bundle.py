"""Poses of a target in all views, with or without the camera, by least squares in pixels without an arm.

This is the problem of Zhang (2000), section 3.3, solved by Levenberg-Marquardt with analytic derivatives.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from koala3d.calib.arrays import Array, Indices
from koala3d.calib.errors import CalibrationError
from koala3d.calib.intrinsics import projection
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.intrinsics.projection import PLAIN, Form
from koala3d.calib.solver.elimination import Eliminated, eliminate
from koala3d.calib.solver.geometry import by_motion, rotate
from koala3d.calib.solver.levenberg_marquardt import Limits, minimise
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera


@dataclass(frozen=True)
class Bundle:
    """The solution."""

    intrinsics: Array  # in the order of `calib.intrinsics.projection`
    camera_from_board: Array  # (views, 4, 4)
    residuals: Array  # (n, 2) seen minus predicted [px]
    information: Array  # (p, p) of the free intrinsics for corners of unit deviation, poses eliminated [1 / px^2]
    determined: float  # how many of the free intrinsics the corners determine: those that are known from elsewhere do not count

    @property
    def variance(self) -> float:
        """Of a corner per axis, as the residuals show it [px^2]; smaller than 1e-12 are rounding errors."""
        freedom = self.residuals.size - 6 * len(self.camera_from_board) - self.determined
        return max(float((self.residuals**2).sum()) / max(freedom, 1), 1e-12)


LIMITS = Limits(max_steps=30, tolerance=1e-10, least_cost=1e-8, rounding=1e-12, max_damping=2e7)


class Corners(NamedTuple):
    """The corners of all views in one list."""

    view: Indices  # (n,) ascending
    pixels: Array  # (n, 2) where they are seen [px]
    points: Array  # (n, 3) on the board [m]


def fit(
    corners: Corners,
    intrinsics: Array,
    camera_from_board: Array,
    free: tuple[str, ...] = (),
    form: Form = PLAIN,
    known: IntrinsicsPrior | None = None,
    sigma_px: float = 1.0,
) -> Bundle:
    """Minimise the distance of seen and predicted corners. Raises CalibrationError where a board starts behind the camera.

    The search starts from `intrinsics`, of which those of `free` are estimated, and from (views, 4, 4) poses. What is `known` of
    free intrinsics is weighed against corners with a standard deviation of `sigma_px` per axis.
    """
    problem = _Problem(corners, free, form, known, sigma_px)
    found, _ = minimise(_Point(problem, intrinsics, camera_from_board), LIMITS)
    determined = float(len(free))
    if known is not None:
        rows = problem.known_rows(found.intrinsics)[:, :-1]
        determined -= float(np.sum((rows @ np.linalg.inv(found.system.root)) ** 2))
    return Bundle(found.intrinsics, found.camera_from_board, found.residuals, found.system.information, determined)


def linearised(
    corners: Corners,
    camera: Camera,
    camera_from_board: Array,
    free: tuple[str, ...],
    known: IntrinsicsPrior | None,
    sigma_px: float,
) -> Eliminated:
    """The linear problem about a camera and (views, 4, 4) poses, which are eliminated; arguments and errors as those of `fit`."""
    problem = _Problem(corners, free, projection.form(camera), known, sigma_px)
    return _Point(problem, projection.vector(camera), camera_from_board).system


class _Problem(NamedTuple):
    """What stays the same during a fit."""

    corners: Corners
    free: tuple[str, ...]
    form: Form
    known: IntrinsicsPrior | None
    sigma_px: float

    def known_rows(self, intrinsics: Array) -> Array:
        """(k, p + 1) what is known of the p free intrinsics [px]."""
        if self.known is None:
            return np.zeros((0, len(self.free) + 1))
        return self.sigma_px * self.known.rows(self.free, intrinsics)


class _Point:
    """A camera and poses, with residuals and the linear problem about them; poses are perturbed from the left."""

    def __init__(self, problem: _Problem, intrinsics: Array, camera_from_board: Array) -> None:
        self.problem, self.intrinsics, self.camera_from_board = problem, intrinsics, camera_from_board
        corners = problem.corners
        rotations, translations = camera_from_board[corners.view, :3, :3], camera_from_board[corners.view, :3, 3]
        in_camera = rotate(rotations, corners.points) + translations
        if not in_camera[:, 2].min() > 1e-6:
            raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")
        predicted, by_camera, by_intrinsics = projection.project(in_camera, intrinsics, problem.form)
        self.residuals = corners.pixels - predicted
        self._known = problem.known_rows(intrinsics)
        self.cost = float((self.residuals**2).sum() + (self._known[:, -1] ** 2).sum())
        self._columns = projection.columns(problem.free)
        self._rows = by_motion(by_camera, in_camera), by_intrinsics[..., self._columns], self.residuals[..., None]

    @cached_property
    def system(self) -> Eliminated:
        """The linear problem."""
        own = np.zeros((len(self.camera_from_board), 6, 7))
        return eliminate(self.problem.corners.view, np.concatenate(self._rows, -1), own, self._known)

    def stepped(self, damping: float) -> "_Point":
        """The point after one damped step."""
        step, twists = self.system.step(damping)
        intrinsics = self.intrinsics.copy()
        intrinsics[self._columns] += step
        moved = pose.from_rotation_vector(twists[:, 3:], twists[:, :3]) @ self.camera_from_board
        return _Point(self.problem, intrinsics, moved)
