"""Cameras from two halves of a session: do not trust the calibration in image regions where they disagree.

Both halves see the same lens, so differences are noise or errors of the lens model. A small rotation of the camera resembles
a shift of its principal point. The best rotation is therefore removed first (as in mrcal's projection difference).
"""

from collections.abc import Sequence

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.intrinsics import fitting, over_image
from koala3d.calib.intrinsics.lenses import Lens
from koala3d.calib.intrinsics.over_image import Map
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError


def cross_validate(camera: Camera, lens: Lens, observations: Sequence[Observation], camera_from_board: Array) -> Map:
    """Fit every other view, and the rest, with one lens, and compare. Raises CalibrationError where a half cannot be fitted.

    The fits start from `camera` and the (views, 4, 4) poses `camera_from_board`.
    """
    halves = [fitting.fit(observations[half::2], camera, camera_from_board[half::2], lens)[0] for half in (0, 1)]
    return difference(halves[0], halves[1])


def compared(first: Camera, second: Camera, where: object) -> Map:
    """`difference` from the camera of the file `where`. Raises UsageError if that is for images of another size."""
    sizes = [f"{camera.width}x{camera.height}" for camera in (first, second)]
    if sizes[0] != sizes[1]:
        remedy = "compare two of one camera setting"
        raise UsageError("is for images of another size", where=where, why=f"{sizes[1]}, not {sizes[0]}", remedy=remedy)
    return difference(first, second)


def difference(first: Camera, second: Camera, cells: int = 24) -> Map:
    """Distance between where `first` and `second` see the same directions, on a grid over the image."""
    columns, rows, pixels = over_image.cells(first, cells, cells)
    directions = first.directions(pixels)
    turn = np.eye(3)
    for _ in range(5):  # Gauss-Newton for the rotation that brings the two closest
        turned = directions @ turn.T
        off = pixels - second.project(turned)
        jacobian = np.empty((len(pixels), 2, 3))
        for axis in range(3):
            step = 1e-6 * np.eye(3)[axis]
            moved = turned @ pose.from_rotation_vector(step)[:3, :3].T
            jacobian[..., axis] = (second.project(moved) - second.project(turned)) / 1e-6
        step = np.linalg.lstsq(jacobian.reshape(-1, 3), off.ravel(), rcond=None)[0]
        turn = pose.from_rotation_vector(step)[:3, :3] @ turn
    distance = np.linalg.norm(pixels - second.project(directions @ turn.T), axis=-1)
    return Map(columns, rows, distance.reshape(cells, cells))
