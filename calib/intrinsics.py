"""Intrinsics from views of a flat target (Zhang 2000, through OpenCV), with as many coefficients as the views support.

The distortion model is chosen by what it does for views that it has not seen: each candidate is fitted on some views,
the others are judged with their pose alone left free. A coefficient stays only where it lowers that held-out error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib import projection
from calib.errors import CalibrationError, TargetError, Unobservable
from calib.targets import Observation
from datasets import conventions, pose
from datasets.camera_model import Camera

MIN_VIEWS = 5
MIN_TOTAL_CORNERS = 100
MODELS: tuple[tuple[str, ...], ...] = ((), ("k1",), ("k1", "k2"), ("k1", "k2", "p1", "p2"), ("k1", "k2", "p1", "p2", "k3"))
"""Candidate sets of distortion coefficients, each contained in the next."""
GAIN = 0.002
"""Share by which a larger model must lower the held-out error to be kept: less is the luck of the draw."""
MAX_FOCAL_STD = 0.03
"""Relative standard deviation of the focal length from which on it counts as not observed."""
MIN_TILT_RAD = float(np.deg2rad(6))
"""Rms angle between the target's normals and their mean below which the views count as one direction."""
_TILT = "tilt the target by 20 to 40 degrees in several directions and fill the image with it"
_FIXED = {"k1": cv2.CALIB_FIX_K1, "k2": cv2.CALIB_FIX_K2, "p1": cv2.CALIB_ZERO_TANGENT_DIST, "k3": cv2.CALIB_FIX_K3}
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class Intrinsics:
    """A camera estimated from views of a target."""

    camera: Camera
    std: dict[str, float]
    """Standard deviation of each estimated value [px for fx fy cx cy, else 1]."""
    rms_px: float
    """Root mean square distance between seen and predicted corner [px]."""
    held_out_px: float
    """The same for views that the fit had not seen [px]."""
    view_rms_px: dict[str, float]
    """By name of the view [px]."""
    coverage: float
    """Share of the image, in cells of an 8 x 8 grid, in which a corner was seen."""
    camera_from_board: NDArray[np.float64]
    """(views, 4, 4)."""

    @property
    def distortion(self) -> tuple[str, ...]:
        """Names of the distortion coefficients that were estimated."""
        return tuple(name for name in self.std if name in projection.NAMES[4:])


def calibrate(
    observations: Sequence[Observation], width: int, height: int, *, models: Sequence[tuple[str, ...]] = MODELS
) -> Intrinsics:
    """Estimate a camera from `observations` in images of `width` x `height` [px].

    Raises:
        TargetError: too few views or corners.
        Unobservable: the views do not determine the focal length (all look straight at the target).
        CalibrationError: no fit was found.
    """
    check_enough(observations)
    errors = {model: _held_out(observations, width, height, model) for model in models}
    chosen = models[0]
    for model in models[1:]:
        if errors[model] < (1 - GAIN) * errors[chosen]:
            chosen = model
    camera, std, poses = _fit(observations, width, height, chosen)
    _check_directions(poses)
    relative = max(std["fx"] / camera.fx, std["fy"] / camera.fy)
    if relative > MAX_FOCAL_STD:
        raise Unobservable("focal length is not observable", why=f"its standard deviation is {relative:.1%} of it",
                           remedy=_TILT)  # fmt: skip
    residuals = [reproject(camera, p, o) - o.pixels for p, o in zip(poses, observations, strict=True)]
    return Intrinsics(
        camera, std, _rms(residuals), errors[chosen],
        {o.name: _rms([r]) for o, r in zip(observations, residuals, strict=True)},
        coverage(observations, width, height), poses,
    )  # fmt: skip


def check_enough(observations: Sequence[Observation]) -> None:
    """Raise TargetError where there are fewer views or corners than a calibration needs."""
    corners = sum(len(o.ids) for o in observations)
    if len(observations) < MIN_VIEWS or corners < MIN_TOTAL_CORNERS:
        raise TargetError(
            "target is seen too little", why=f"{corners} corners in {len(observations)} views, at least {MIN_TOTAL_CORNERS} "
            f"in {MIN_VIEWS} are needed", remedy="record more views with the whole target in the picture, sharp and evenly lit",
        )  # fmt: skip


def _check_directions(camera_from_board: NDArray[np.float64]) -> None:
    """Raise Unobservable where all of the (views, 4, 4) poses look at the target from one direction.

    Focal length and distance then trade freely, the fit goes astray and states a small deviation all the same.
    """
    normals = camera_from_board[:, :3, 2]
    mean = normals.mean(0) / np.linalg.norm(normals.mean(0))
    spread = np.sqrt(np.mean(np.arccos(np.clip(normals @ mean, -1, 1)) ** 2))
    if spread < MIN_TILT_RAD:
        raise Unobservable(
            "focal length is not observable", why=f"the target is tilted by {np.rad2deg(spread):.2g} deg only", remedy=_TILT
        )


def camera_from_board(camera: Camera, observation: Observation) -> NDArray[np.float64]:
    """(4, 4) pose of a target in one view: the better of the two planar solutions, then least squares in pixels."""
    matrix, pixels = _opencv_matrix(camera), conventions.opencv_from_pixels(observation.pixels)
    points, distortion = np.ascontiguousarray(observation.points), camera.distortion
    _, rotations, translations, _ = cv2.solvePnPGeneric(points, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    best, best_rms = None, np.inf
    for rotation, translation in zip(rotations, translations, strict=True):
        rotation, translation = cv2.solvePnPRefineLM(points, pixels, matrix, distortion, rotation, translation)
        candidate = pose.from_rotation_vector(rotation.ravel(), translation.ravel())
        rms = _rms([reproject(camera, candidate, observation) - observation.pixels]) if candidate[2, 3] > 0 else np.inf
        if rms < best_rms:
            best, best_rms = candidate, rms
    if best is None:
        raise CalibrationError(
            "pose of the target cannot be found", where=f"view {observation.name}", remedy="leave this view out"
        )
    return best


def reproject(camera: Camera, camera_from_board: NDArray[np.float64], observation: Observation) -> NDArray[np.float64]:
    """(n, 2) pixels where the corners of `observation` should be."""
    return camera.project(observation.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])


def coverage(observations: Sequence[Observation], width: int, height: int) -> float:
    """Share of the cells of an 8 x 8 grid over the image that hold a corner."""
    pixels = np.concatenate([o.pixels for o in observations])
    cells = np.clip((pixels / [width, height] * 8).astype(int), 0, 7)
    return len(np.unique(cells, axis=0)) / 64


def _opencv_matrix(camera: Camera) -> NDArray[np.float64]:
    matrix = camera.matrix
    matrix[:2, 2] = conventions.opencv_from_pixels(matrix[:2, 2])
    return matrix


def _rms(residuals: Sequence[NDArray[np.float64]]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.concatenate(residuals) ** 2, axis=-1))))


def _fit(
    observations: Sequence[Observation], width: int, height: int, model: tuple[str, ...]
) -> tuple[Camera, dict[str, float], NDArray[np.float64]]:
    """Camera, standard deviations and (views, 4, 4) camera_from_board for one distortion model."""
    points = [o.points.astype(np.float32) for o in observations]
    pixels = [conventions.opencv_from_pixels(o.pixels).astype(np.float32) for o in observations]
    flags = sum(flag for name, flag in _FIXED.items() if name not in model)
    try:
        rms, matrix, distortion, rotations, translations, std, _, _ = cv2.calibrateCameraExtended(
            points, pixels, (width, height), None, None, flags=flags, criteria=_STOP
        )
    except cv2.error as error:
        raise CalibrationError(
            "intrinsics cannot be fitted", why=str(error.err), remedy="record views from more directions"
        ) from None
    if not np.isfinite(rms):
        raise CalibrationError("intrinsics cannot be fitted", why="the fit diverged", remedy="record views from more directions")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise Unobservable("focal length is not observable", why=f"the fit gives {matrix[0, 0]:.3g} px", remedy=_TILT)
    focal, centre = matrix[[0, 1], [0, 1]], conventions.pixels_from_opencv(matrix[:2, 2])
    values = np.concatenate([focal, centre, distortion.ravel()[:5]])
    camera = projection.with_vector(Camera(width, height, 1, 1, 0, 0), values).checked(where="estimated camera")
    deviations = {name: float(std[i, 0]) for i, name in enumerate(projection.NAMES) if i < 4 or name in model}
    poses = [pose.from_rotation_vector(r.ravel(), t.ravel()) for r, t in zip(rotations, translations, strict=True)]
    return camera, deviations, np.stack(poses)


def _held_out(observations: Sequence[Observation], width: int, height: int, model: tuple[str, ...]) -> float:
    """Rms [px] over views that the fit has not seen, in up to four folds; infinite where a fit fails."""
    folds = min(4, len(observations) // 2)
    residuals = []
    try:
        for fold in range(folds):
            rest = [o for i, o in enumerate(observations) if i % folds != fold]
            camera, _, _ = _fit(rest, width, height, model)
            for observation in observations[fold::folds]:
                residuals.append(reproject(camera, camera_from_board(camera, observation), observation) - observation.pixels)
    except CalibrationError:
        return np.inf
    return _rms(residuals)
