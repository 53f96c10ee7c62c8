"""Hand-eye calibration in closed form, camera on the flange, through OpenCV.

Two views i, j give A X = X B with A = flange_i_from_flange_j, B = camera_i_from_camera_j and X = mount_from_camera (Tsai
1989, Park 1994, Horaud 1995, Andreff 1999, Daniilidis 1999); Shah 2013 and Li 2010 solve for X and stand_from_board together.
All treat the poses as exact, so they serve as a start of the refinement. `calib.handeye.model` defines mount and stand; with
the camera on the flange they are flange and base.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError, nearest

_RELATIVE = {n: getattr(cv2, f"CALIB_HAND_EYE_{n.upper()}") for n in ("tsai", "park", "horaud", "andreff", "daniilidis")}
_ABSOLUTE = {n: getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{n.upper()}") for n in ("shah", "li")}
METHODS = (*_RELATIVE, *_ABSOLUTE)
SUBSETS = 40  # groups of views tried for a start: with two fifths of the views wrong, one group of five in thirteen is right


@dataclass(frozen=True)
class HandEye:
    """A closed-form solution and how well the views agree with it."""

    method: str
    mount_from_camera: Array  # (4, 4)
    stand_from_board: Array  # (4, 4)
    translation_residual_m: Array  # (views,) distance between the board's place by each view and by all [m]
    rotation_residual_rad: Array  # (views,) the same for its orientation [rad]

    @property
    def distance(self) -> Array:
        """(views,) both together [m], rotations at a lever of half a metre."""
        return np.hypot(self.translation_residual_m, 0.5 * self.rotation_residual_rad)

    def score(self, keep: Mask) -> float:
        """Rms `distance` of the views of `keep` (views,) [m]; lower is better."""
        return float(np.sqrt(np.mean(self.distance[keep] ** 2)))


def solve(stand_from_mount: Array, camera_from_board: Array, method: str = "park") -> HandEye:
    """Solve with one of `METHODS`, from (views, 4, 4) poses as the arm reported them and as seen.

    Raises:
        CalibrationError: fewer than 3 views, an unknown method, or OpenCV found no answer.
        DatasetError: its answer is no rigid transform.
    """
    return assess(stand_from_mount, camera_from_board, _mount(stand_from_mount, camera_from_board, method), method)


def _mount(stand_from_mount: Array, camera_from_board: Array, method: str) -> Array:
    """(4, 4) mount_from_camera by one method. Arguments and errors are those of `solve`."""
    if method not in METHODS:
        raise CalibrationError(f"no hand-eye method {method!r}", remedy=nearest(method, METHODS))
    if len(stand_from_mount) < 3:
        raise CalibrationError("hand-eye calibration needs at least 3 views", why=f"{len(stand_from_mount)} given")
    if not (np.isfinite(stand_from_mount).all() and np.isfinite(camera_from_board).all()):
        raise CalibrationError("poses are not finite", remedy="leave out the views without a pose")
    try:
        if method in _RELATIVE:  # OpenCV's gripper2base is stand_from_mount, target2cam camera_from_board
            parts = (*_parts(stand_from_mount), *_parts(camera_from_board))
            rotation, translation = cv2.calibrateHandEye(*parts, method=_RELATIVE[method])
            mount_from_camera = pose.rigid(rotation, translation.ravel())
        else:
            parts = (*_parts(camera_from_board), *_parts(pose.inverse(stand_from_mount)))
            _, _, rotation, translation = cv2.calibrateRobotWorldHandEye(*parts, method=_ABSOLUTE[method])
            mount_from_camera = pose.inverse(pose.rigid(rotation, translation.ravel()))
    except cv2.error as error:
        raise CalibrationError(f"hand-eye method {method} failed", why=str(error.err)) from None
    return pose.checked(mount_from_camera, where=f"hand-eye method {method}", tolerance=0.1)


def _parts(poses: Array) -> tuple[list[Array], list[Array]]:
    """Rotations and translations as OpenCV takes them."""
    return list(poses[:, :3, :3]), list(poses[:, :3, 3])


def assess(stand_from_mount: Array, camera_from_board: Array, mount_from_camera: Array, method: str) -> HandEye:
    """The answer completed by the median place of the board and what each view disagrees with it by."""
    return _assessed(stand_from_mount, camera_from_board, [(method, mount_from_camera)])[0]


def _assessed(stand_from_mount: Array, camera_from_board: Array, answers: Sequence[tuple[str, Array]]) -> list[HandEye]:
    """Each answer, a method and its mount_from_camera, completed as by `assess`."""
    boards = stand_from_mount @ np.stack([mount for _, mount in answers])[:, None] @ camera_from_board
    quaternions = Rotation.from_matrix(boards[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(*boards.shape[:2], 4)
    places, angles, mean = boards[..., :3, 3], np.zeros(boards.shape[:2]), np.zeros((len(boards), 4))
    keep = _near_the_middle(quaternions)
    for _ in range(3):  # the mean rotation of the views near the last mean: a median of rotations
        chosen = quaternions * keep[..., None]
        mean = np.linalg.eigh(np.swapaxes(chosen, 1, 2) @ chosen)[1][..., -1]  # Markley et al. 2007, eq. 13
        angles = _angles(quaternions, mean[:, None])
        keep = angles <= 3 * np.median(angles, axis=1, keepdims=True) + 1e-9
    place = np.median(places, axis=1)
    distances = np.linalg.norm(places - place[:, None], axis=-1)
    stand_from_board = pose.rigid(Rotation.from_quat(mean).as_matrix(), place)
    return [HandEye(*answer, *rest) for answer, *rest in zip(answers, stand_from_board, distances, angles, strict=True)]


def _angles(quaternions: Array, others: Array) -> Array:
    """(...) angles [rad, 0..pi] between rotations given by (..., 4) unit quaternions; accurate near 0."""
    apart = np.minimum(np.linalg.norm(quaternions - others, axis=-1), np.linalg.norm(quaternions + others, axis=-1))
    return 4 * np.arcsin(apart / 2)


def _near_the_middle(quaternions: Array) -> Mask:
    """(k, views) the half of k times (views, 4) rotations nearest to their medoid.

    Outliers cannot spoil a medoid as they spoil a mean.
    """
    likeness = np.abs(quaternions @ np.swapaxes(quaternions, 1, 2))
    middle = np.median(likeness, axis=2).argmax(1)
    nearness = likeness[np.arange(len(middle)), middle]
    return nearness >= np.median(nearness, axis=1, keepdims=True)


def solve_robustly(stand_from_mount: Array, camera_from_board: Array) -> tuple[HandEye, Mask]:
    """The best closed-form answer by `score`, and which views agree with it, (views,).

    A start comes from few views, chosen so that most of the others agree with it (least median of squares; Rousseeuw 1984):
    up to two fifths of the views may be wrong. A view disagrees if it is further than 5 medians (and 2 mm or 0.5 degrees)
    from the others, for instance because the arm or the board was moving. Such views are left out, and the answer is computed
    again. Raises CalibrationError where no method finds an answer.
    """
    best = _consensus(stand_from_mount, camera_from_board)
    keep = _agreeing(best)
    for _ in range(4):
        answers = _answers(stand_from_mount, camera_from_board, [keep], METHODS)
        best = min(answers, key=lambda answer: answer.score(keep))
        agrees = _agreeing(best)
        if agrees.sum() < 3 or (agrees == keep).all():
            break
        keep = agrees
    return best, keep


def _answers(
    stand_from_mount: Array, camera_from_board: Array, groups: Sequence[NDArray[Any]], methods: Sequence[str]
) -> list[HandEye]:
    """The answers of all methods from each group of views, assessed on all views. Raises CalibrationError where all fail."""
    answers = []
    for group in groups:
        for method in methods:
            with suppress(KoalaError):
                answers.append((method, _mount(stand_from_mount[group], camera_from_board[group], method)))
    if not answers:
        raise CalibrationError("no closed-form hand-eye method found an answer", remedy="record views from more directions")
    return _assessed(stand_from_mount, camera_from_board, answers)


def _consensus(stand_from_mount: Array, camera_from_board: Array) -> HandEye:
    """The answer with which the majority of the views agrees best, among those from all views and from groups of five."""
    views = len(stand_from_mount)
    rng = np.random.default_rng(0)
    groups, majority = [np.arange(views)], max(3, int(np.ceil(0.6 * views)))
    groups += [np.sort(rng.permutation(views)[:5]) for _ in range(SUBSETS if views > 5 else 0)]
    found = _answers(stand_from_mount, camera_from_board, groups, ("park", "shah"))
    return min(found, key=lambda answer: np.sort(answer.distance)[majority - 1])


def _agreeing(answer: HandEye) -> Mask:
    """(views,) whose disagreement is not far above the median of all views."""
    distances, angles = answer.translation_residual_m, answer.rotation_residual_rad
    return (distances <= max(5 * np.median(distances), 2e-3)) & (angles <= max(5 * np.median(angles), np.deg2rad(0.5)))
