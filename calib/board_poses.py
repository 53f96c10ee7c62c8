"""Where a camera sees the target in each picture of a recording, and how surely: what `capture repeatability` asks for."""

from pathlib import Path
from typing import Any

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets import screening
from koala3d.calib.targets.detection import MIN_CORNERS, Observation
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import Recording

SAME_RAD = 0.01
"""Joint angles that differ by less are of one place of the arm."""
USUAL = 0.9
"""Corners count that this share of the pictures of a place shows: a pose of other corners is a little off by their errors."""


def board_poses(session: TargetSession, recording: Recording, calibration: Path | None) -> dict[str, Any]:
    """The camera, the names of views without the target, and by name of each other view its

        middle      (4, 4) pose of the target's middle in the camera, with the axes of the board [m]
        covariance  (6, 6) of the place of that middle [m] and of turns about it [rad], along the axes of the board, for corners
                    that are off by one pixel (standard deviation per axis, independent)
        residuals   by number of each corner, its place less where it should be [px]

    All pictures from one place of the arm are judged by the same corners; one that lacks some of them counts as without target.

    Args:
        calibration: file with the camera; None: it is estimated from the first pictures, one of each place of the arm.

    Raises UsageError: the calibration is for pictures of another size. Else what an estimate of the camera raises.
    """
    groups = _by_place(session, recording)
    camera = _estimated(session, groups) if calibration is None else _given(session, calibration)
    observations = [one for group in groups for one in _alike(group)]
    middle = np.array([*(session.board.size / 2), 0.0])
    board_from_middle = pose.rigid(np.eye(3), middle)
    found = {}
    for one, matrix in zip(observations, estimate.camera_from_boards(camera, observations), strict=True):
        residuals = one.pixels - estimate.reproject(camera, matrix, one)
        found[one.name] = {
            "middle": (matrix @ board_from_middle).tolist(),
            "covariance": _covariance(camera, matrix @ board_from_middle, one.points - middle).tolist(),
            "residuals": {str(number): vector.tolist() for number, vector in zip(one.ids, residuals, strict=True)},
        }
    unseen = [frame.name for frame in recording.frames if frame.name not in found]
    return {"camera": camera.to_json(), "views": found, "unseen": unseen}


def _by_place(session: TargetSession, recording: Recording) -> list[list[Observation]]:
    """The pictures of each place of the arm."""
    joints = {frame.name: frame.joints for frame in recording.frames}
    groups: list[list[Observation]] = []
    for one in session.observations:
        mine = next((g for g in groups if np.abs(joints[g[0].name] - joints[one.name]).max() < SAME_RAD), None)
        if mine is None:
            groups.append([one])
        else:
            mine.append(one)
    return groups


def _alike(group: list[Observation]) -> list[Observation]:
    """The pictures of one place that show all corners which are usually seen from there, with these alone."""
    numbers, counts = np.unique(np.concatenate([one.ids for one in group]), return_counts=True)
    usual = numbers[counts >= USUAL * len(group)]
    whole = [one for one in group if len(usual) >= MIN_CORNERS and np.isin(usual, one.ids).all()]
    return [screening.some(one, np.isin(one.ids, usual)) for one in whole]


def _covariance(camera: Camera, camera_from_middle: Array, points: Array) -> Array:
    """(6, 6) inverse of the normal matrix of (n, 3) points about the middle; derivatives by central differences."""
    step, columns = 1e-6, []
    for row in np.eye(6) * step:
        ends = []
        for sign in (1, -1):
            moved = camera_from_middle @ pose.from_rotation_vector(sign * row[3:], sign * row[:3])
            ends.append(camera.project(points @ moved[:3, :3].T + moved[:3, 3]).ravel())
        columns.append((ends[0] - ends[1]) / (2 * step))
    jacobian = np.stack(columns, -1)
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian), np.float64)


def _given(session: TargetSession, path: Path) -> Camera:
    calibration = Calibration.load(path)
    camera, theirs, ours = calibration.camera, calibration.region, session.region
    if theirs is not None and ours is not None and theirs != ours:
        camera = theirs.converted(camera, ours)
    if (camera.width, camera.height) != (session.width, session.height):
        why = f"it is for {camera.width}x{camera.height}, the pictures are {session.width}x{session.height}"
        raise UsageError("is for pictures of another size", where=path, why=why, remedy="leave --calibration out")
    return camera


def _estimated(session: TargetSession, groups: list[list[Observation]]) -> Camera:
    return calibrate.calibrate_intrinsics(session.with_observations([group[0] for group in groups]), "brown").camera
