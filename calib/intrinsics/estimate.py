"""Intrinsics from views of a flat target (Zhang 2000), with as many coefficients as the views support.

OpenCV finds a start. Corners and views with gross errors are left out, a lens is chosen (`calib.intrinsics.choice`) and fitted to
all views (`calib.intrinsics.fitting`). If an ordinary lens leaves much, a fisheye is tried from a start of its own.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import cv2
import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError, TargetError, Unobservable
from koala3d.calib.intrinsics import bundle, choice, projection
from koala3d.calib.intrinsics.fitting import DIRECTIONS, TILT, fit, flat, rms
from koala3d.calib.intrinsics.lenses import EVERY, FISHEYE, USUAL, Lens, Spline
from koala3d.calib.targets import screening
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import conventions, pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import KoalaError

MIN_VIEWS = 5
MIN_TOTAL_CORNERS = 100
MAX_FOCAL_STD = 0.03  # relative standard deviation above which the focal length counts as not observable
MIN_TILT_RAD = float(np.deg2rad(6))
"""Views count as one direction if the rms angle between the target's normals and their mean is smaller."""
OUTLIER = 6.0  # corners with larger residuals are left out [robust standard deviations]
POOR_PX = 1.0  # an ordinary lens that leaves more than this may be a fisheye
MAX_RMS_PX = 3.0  # a lens that leaves more than this describes something else than the camera
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class Intrinsics:
    """A camera estimated from views of a target."""

    camera: Camera
    lens: Lens
    covariance: Array  # (k, k) of the estimated values, in the order of `lens.free`
    rms_px: float  # root mean square distance between seen and predicted corner [px]
    held_out_px: float  # the same for views that the fit had not seen [px]
    view_rms_px: dict[str, float]  # by name of the view [px]
    coverage: float  # share of the image, in cells of an 8 x 8 grid, in which a corner was seen
    camera_from_board: Array  # (views, 4, 4), in the order of `observations`
    observations: tuple[Observation, ...]
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of each estimated value [px for fx fy cx cy, else 1]."""
        return dict(zip(self.lens.free, map(float, np.sqrt(np.diag(self.covariance))), strict=True))

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a corner per axis [px]."""
        return max(self.rms_px / np.sqrt(2), 1e-4)


def calibrate(
    observations: Sequence[Observation], width: int, height: int, *, lenses: Sequence[Lens] = EVERY, spline: Spline = "never"
) -> Intrinsics:
    """Estimate a camera from `observations` in images of `width` x `height` [px], with the best of `lenses`.

    Raises:
        TargetError: too few views or corners, for a spline that is wanted always among them.
        Unobservable: the views do not determine the focal length (all look straight at the target).
        CalibrationError: no fit was found, or none that leaves less than `MAX_RMS_PX`.
    """
    found = _estimated(observations, width, height, lenses, spline)
    fisheyes = [lens for lens in lenses if lens.fisheye]
    if found.rms_px > POOR_PX and fisheyes and not found.camera.fisheye:  # from a start of its own: this one led astray
        with suppress(KoalaError):
            other = _estimated(observations, width, height, fisheyes, spline)
            found = min(found, other, key=lambda one: one.held_out_px)
    if found.rms_px > MAX_RMS_PX:
        why, remedy = f"{found.rms_px:.2g} px rms are left", "check the description of the target and the kind of lens (--lens)"
        raise CalibrationError("no lens fits the corners", why=why, remedy=remedy)
    return found


def _estimated(
    observations: Sequence[Observation], width: int, height: int, lenses: Sequence[Lens], spline: Spline
) -> Intrinsics:
    """`calibrate` from the start that OpenCV finds for the first of `lenses`, however poor the result."""
    check_enough(observations)
    observations, left_out = screening.agreeing_with_plane(observations)
    check_enough(observations)
    first, poses = _start(observations, width, height, lenses[0].fisheye)
    observations, poses, more = _without_outliers(observations, first, poses, lenses, may_be_splined=spline != "never")
    check_enough(observations)
    chosen, squares = choice.choose(observations, first, poses, lenses)
    if spline != "never":
        chosen, squares = choice.with_knots(observations, first, poses, chosen, squares, asked=spline == "if better")
    held_out_px = float(np.sqrt(squares.sum() / sum(len(o.ids) for o in observations)))
    return _finished(observations, first, poses, chosen, held_out_px, {**left_out, **more})


def _finished(
    observations: Sequence[Observation], first: Camera, poses: Array, lens: Lens, held_out_px: float, left_out: dict[str, str]
) -> Intrinsics:
    """The final fit, with checks that the result is meaningful."""
    camera, fitted = fit(observations, first, poses, lens)
    _check_directions(fitted.camera_from_board)
    scale = np.sqrt(np.maximum(np.diag(fitted.information), 1e-300))
    covariance = (
        fitted.variance * np.linalg.pinv(fitted.information / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    )
    relative = np.sqrt(np.diag(covariance)[:2]) / [camera.fx, camera.fy]
    if not relative.max() <= MAX_FOCAL_STD:
        why = f"its standard deviation is {relative.max():.1%} of it"
        raise Unobservable("focal length is not observable", why=why, remedy=TILT)
    view = flat(observations)[0]
    by_view = {o.name: rms(fitted.residuals[view == i]) for i, o in enumerate(observations)}
    errors = rms(fitted.residuals), held_out_px, by_view
    seen, boards = coverage(observations, camera.width, camera.height), fitted.camera_from_board
    return Intrinsics(camera, lens, covariance, *errors, seen, boards, tuple(observations), left_out)


def check_enough(observations: Sequence[Observation], least: int = MIN_TOTAL_CORNERS, views: int = MIN_VIEWS) -> None:
    """Raise TargetError where there are fewer views or corners than a calibration needs."""
    corners = sum(len(o.ids) for o in observations)
    if len(observations) < views or corners < least:
        why = f"{corners} corners in {len(observations)} views, at least {least} in {views} are needed"
        remedy = "record more views with the whole target in the picture, sharp and evenly lit"
        raise TargetError("target is not seen often enough", why=why, remedy=remedy)


def _check_directions(camera_from_board: Array) -> None:
    """Raise Unobservable where all of the (views, 4, 4) poses look at the target from one direction.

    Focal length and distance then trade freely, the fit goes astray and states a small deviation all the same.
    """
    normals = camera_from_board[:, :3, 2]
    mean = normals.mean(0) / np.linalg.norm(normals.mean(0))
    spread = np.sqrt(np.mean(np.arccos(np.clip(normals @ mean, -1, 1)) ** 2))
    if spread < MIN_TILT_RAD:
        why = f"the target is tilted by {np.rad2deg(spread):.2g} deg only"
        raise Unobservable("focal length is not observable", why=why, remedy=TILT)


def camera_from_boards(camera: Camera, observations: Sequence[Observation]) -> Array:
    """(views, 4, 4) poses of a target: in each view the better of the two planar solutions, then least squares in pixels.

    Raises CalibrationError, which names the view, where one allows no pose in front of the camera.
    """
    found = [_planar_poses(camera, observation) for observation in observations]
    fits = []
    for which in (0, -1):
        starts = np.stack([poses[which] for poses in found])
        fits.append(bundle.fit(flat(observations), projection.vector(camera), starts, form=projection.form(camera)))
    view = flat(observations)[0]
    squares = [np.bincount(view, (f.residuals**2).sum(-1), len(observations)) for f in fits]
    return np.where((squares[0] <= squares[1])[:, None, None], fits[0].camera_from_board, fits[1].camera_from_board)


def _planar_poses(camera: Camera, observation: Observation) -> list[Array]:
    """The one or two (4, 4) poses that a flat target can have (Collins & Bartoli 2014), in front of the camera, best first."""
    points, ideal = (np.ascontiguousarray(a) for a in (observation.points, camera.directions(observation.pixels)[:, :2]))
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        rotations, translations = (), ()
    poses = [pose.from_rotation_vector(r.ravel(), t.ravel()) for r, t in zip(rotations, translations, strict=True)]
    poses = [p for p in poses if np.isfinite(p).all() and (points @ p[2, :3] + p[2, 3]).min() > 0]
    if not poses:
        where = f"view {observation.name}"
        raise CalibrationError("pose of the target cannot be found", where=where, remedy="leave this view out")
    return poses


def reproject(camera: Camera, camera_from_board: Array, observation: Observation) -> Array:
    """(n, 2) pixels where the corners of `observation` should be."""
    return camera.project(observation.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])


def coverage(observations: Sequence[Observation], width: int, height: int) -> float:
    """Share of the cells of an 8 x 8 grid over the image that hold a corner."""
    pixels = np.concatenate([o.pixels for o in observations])
    cells = np.clip((pixels / [width, height] * 8).astype(int), 0, 7)
    return len(np.unique(cells, axis=0)) / 64


def _start(observations: Sequence[Observation], width: int, height: int, fisheye: bool) -> tuple[Camera, Array]:
    """A camera with k1 k2 (of a fisheye, with none), and (views, 4, 4) poses of the target, by OpenCV."""
    points = [o.points.astype(np.float32) for o in observations]
    pixels = [conventions.opencv_from_pixels(o.pixels).astype(np.float32) for o in observations]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    try:
        found = cv2.calibrateCamera(points, pixels, (width, height), None, None, flags=flags, criteria=_STOP)
    except cv2.error as error:
        raise CalibrationError("intrinsics cannot be fitted", why=str(error.err), remedy=DIRECTIONS) from None
    error_px, matrix, distortion, rotations, translations = found
    if not np.isfinite(error_px):
        raise CalibrationError("intrinsics cannot be fitted", why="the fit diverged", remedy=DIRECTIONS)
    focal, centre = matrix[[0, 1], [0, 1]], conventions.pixels_from_opencv(matrix[:2, 2])
    if not focal.min() > 0:
        raise Unobservable("focal length is not observable", why=f"the fit gives {focal[0]:.3g} px", remedy=TILT)
    k1, k2 = (0.0, 0.0) if fisheye else map(float, distortion.ravel()[:2])
    (fx, fy), (cx, cy) = map(float, focal), map(float, centre)
    camera = Camera(width, height, fx, fy, cx, cy, k1, k2, fisheye=fisheye)
    poses = [pose.from_rotation_vector(r.ravel(), t.ravel()) for r, t in zip(rotations, translations, strict=True)]
    return camera, np.stack(poses)


def _without_outliers(
    observations: Sequence[Observation], first: Camera, poses: Array, lenses: Sequence[Lens], *, may_be_splined: bool
) -> tuple[list[Observation], Array, dict[str, str]]:
    """Observations without corners and views that a first fit cannot explain; their poses; the views left out, and why.

    Corners are removed first, compared with the other corners of their view: a few wrong corners spoil the fit of a good view.
    If it `may_be_splined`, corners may also agree with those near them in the image.
    """
    middle = FISHEYE[0] if first.fisheye else USUAL
    left_out: dict[str, str] = {}
    observations = list(observations)
    for _ in range(12):
        _, fitted = fit(observations, first, poses, middle)
        distance, view = np.linalg.norm(fitted.residuals, axis=1), flat(observations)[0]
        by_view = np.array([np.median(distance[view == i]) for i in range(len(observations))])
        typical = max(float(np.median(by_view)), 1e-3)
        limits = OUTLIER * np.maximum(by_view, typical) / 1.1774  # the median length of a Gaussian in two dimensions, in sigmas
        if may_be_splined:
            distance = np.minimum(distance, screening.from_neighbours(flat(observations).pixels, fitted.residuals))
        kept = [screening.some(o, distance[view == i] <= limits[i]) for i, o in enumerate(observations)]
        kept = [new if len(new.ids) >= screening.MIN_CORNERS else old for new, old in zip(kept, observations, strict=True)]
        survivors = np.arange(len(kept))
        if all(len(new.ids) == len(old.ids) for new, old in zip(kept, observations, strict=True)):
            survivors = np.flatnonzero(by_view <= max(5 * typical, 0.02))
            if len(survivors) in (len(kept), *range(MIN_VIEWS)):
                break
            for i in np.setdiff1d(np.arange(len(kept)), survivors):
                left_out[observations[i].name] = f"its corners are {by_view[i]:.2g} px off, those of other views {typical:.2g} px"
        observations, poses = [kept[i] for i in survivors], fitted.camera_from_board[survivors]
    return observations, poses, left_out
