"""Poses of a target in all views at once, with or without the camera: least squares in pixels, without an arm.

What Zhang (2000) minimises in his section 3.3, by Levenberg-Marquardt with analytic derivatives.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibrationError
from calib.intrinsics import projection
from calib.solver.elimination import Eliminated, eliminate
from calib.solver.geometry import by_motion, rotate
from datasets import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bundle:
    """The answer."""

    intrinsics: Array
    """(12,) in the order of `projection.NAMES`."""
    camera_from_board: Array
    """(views, 4, 4)."""
    residuals: Array
    """(n, 2) seen minus predicted [px]."""
    information: Array
    """(p, p) of the free intrinsics for corners of unit deviation, poses eliminated [1 / px^2]."""


def fit(
    view: NDArray[np.int64], pixels: Array, points: Array, intrinsics: Array, camera_from_board: Array,
    free: tuple[str, ...] = (), fisheye: bool = False, max_steps: int = 30,
) -> Bundle:  # fmt: skip
    """Minimise the distance of seen and predicted corners.

    Args:
        view: (n,) view of each corner, ascending.
        pixels: (n, 2) [px].
        points: (n, 3) on the board [m].
        intrinsics: (12,) to start from.
        camera_from_board: (views, 4, 4) to start from.
        free: intrinsics to estimate; the others stay.
        fisheye: whether the lens is a fisheye.

    Raises:
        CalibrationError: a board lies behind the camera at the start.
    """
    columns = [projection.NAMES.index(name) for name in free]
    damping = 1e-6
    residuals, system = _linear(view, pixels, points, intrinsics, camera_from_board, columns, fisheye)
    for _ in range(max_steps):
        try:
            step, view_steps = system.step(damping)
            moved = intrinsics.copy()
            moved[columns] += step
            turned = pose.from_rotation_vector(view_steps[:, 3:], view_steps[:, :3]) @ camera_from_board
            following = _linear(view, pixels, points, moved, turned, columns, fisheye)
        except (np.linalg.LinAlgError, CalibrationError):
            damping *= 10
            continue
        before, after = (residuals**2).sum(), (following[0] ** 2).sum()
        if not after <= before:
            if damping > 1e6 or before - after > -1e-12 * before:
                break
            damping *= 10
            continue
        intrinsics, camera_from_board, (residuals, system), damping = moved, turned, following, damping / 10
        if before - after <= 1e-10 * before + 1e-18:
            break
    return Bundle(intrinsics, camera_from_board, residuals, system.information)


def _linear(
    view: NDArray[np.int64],
    pixels: Array,
    points: Array,
    intrinsics: Array,
    camera_from_board: Array,
    columns: list[int],
    fisheye: bool,
) -> tuple[Array, Eliminated]:
    """(n, 2) residuals and the linear problem about a state; poses are perturbed from the left."""
    turned = rotate(camera_from_board[view, :3, :3], points)
    in_camera = turned + camera_from_board[view, :3, 3]
    if not in_camera[:, 2].min() > 1e-6:
        raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")
    predicted, by_camera, by_intrinsics = projection.project(in_camera, intrinsics, fisheye)
    residuals = pixels - predicted
    by_pose = by_motion(by_camera, in_camera)
    rows = np.concatenate([by_pose, by_intrinsics[..., columns], residuals[..., None]], -1)
    views = len(camera_from_board)
    return residuals, eliminate(view, rows, np.zeros((views, 6, 7)), np.zeros((0, len(columns) + 1)))
