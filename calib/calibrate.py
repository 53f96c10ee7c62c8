"""From a target session to a calibration: intrinsics alone, or the whole rig.

Hand-eye calibration goes: pose of the board in each view -> closed form (which also finds views that disagree) ->
joint refinement -> covariance -> error on views that the refinement has not seen.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.clocks import latency
from koala3d.calib.clocks.latency import Latency
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import (
    closed_forms,
    credible,
    flatness,
    flips,
    links,
    misread,
    mistakes,
    order,
    outliers,
    repeating,
    surface,
    uncertainty,
    verify,
)
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.intrinsics import estimate, fitting, lenses, projection, splined
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets import screening
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.residuals import Correlation, Residuals

CORNERS_PER_VIEW = 4  # fewest corners of a session whose camera is known: one tag in each view
MAX_DISTANCE_M = 1e7
STATED = Accuracy()  # accuracy that is assumed of a UR5e
LATENCY_ROUNDS, LATENCY_SETTLED = 5, 0.1  # a latency that moves by less than this share of its standard deviation is settled


def calibrate_intrinsics(session: TargetSession, lens: str = "auto") -> Calibration:
    """Intrinsics from the pictures alone; `lens` is a key of `lenses.LENSES`. Raises what `estimate.calibrate` raises."""
    found = _intrinsics(session, lens)
    residuals = Residuals(
        rms_px=found.rms_px,
        held_out_px=found.held_out_px,
        **_views(session, len(found.observations), found.left_out),
        corners=sum(len(o.ids) for o in found.observations),
        coverage=found.coverage,
        view_rms_px=found.view_rms_px,
        camera_correlation=Correlation.of(found.lens.free, found.covariance),
    )
    provenance = {**session.provenance, "method": "intrinsics"}
    return Calibration(found.camera, found.std, region=session.region, residuals=residuals, provenance=provenance)


def _intrinsics(session: TargetSession, lens: str) -> estimate.Intrinsics:
    """Intrinsics from the pictures alone, by the name of the lens."""
    candidates, spline = lenses.LENSES[lens], lenses.SPLINES.get(lens, "never")
    return estimate.calibrate(session.observations, session.width, session.height, lenses=candidates, spline=spline)


def knots(camera: Camera, free: tuple[str, ...], session: TargetSession) -> IntrinsicsPrior | None:
    """What is assumed of the knots of a camera that are `free`; None where there are none."""
    pixels = fitting.flat(session.observations).pixels
    return splined.prior(camera, free, pixels) if any(map(projection.is_knot, free)) else None


def _views(session: TargetSession, used: int, left_out: dict[str, str]) -> dict[str, Any]:
    """Views used, without a target and left out, for the calibration file."""
    left_out = {**session.left_out, **left_out}
    names = {"views_unseen": list(session.unseen), "views_left_out": list(left_out)}
    return {"views_used": used, **names, "why_left_out": left_out}


def calibrate_handeye(
    session: TargetSession,
    given: Calibration | None = None,
    accuracy: Accuracy = STATED,
    lens: str = "auto",
    allow_m: float = uncertainty.MAX_STD_M,
) -> Calibration:
    """Hand-eye pose, board pose and intrinsics together; `lens` is a key of `lenses.LENSES`.

    With the camera beside the arm these are the pose of the camera in the base and that of the board on the flange. Intrinsics
    `given` by another session count with their covariance. From the same session they are only the start, because corners must
    not count twice. `allow_m` relaxes the bound above which an uncertain pose is refused; the calibration is then marked.

    Raises:
        TargetError, Unobservable, CalibrationError: too few views, motion that leaves something undetermined, no fit.
        UsageError: `given` is for images of another size.
    """
    return finished(solve(session, given, accuracy, lens), accuracy, given is not None, allow_m)


@dataclass(frozen=True)
class First:
    """What is known before the arm's poses are used."""

    session: TargetSession
    camera: Camera
    free: tuple[str, ...]
    known: IntrinsicsPrior | None
    sigma_px: float  # standard deviation of a corner per axis
    left_out: dict[str, str]


@dataclass(frozen=True)
class Solution:
    """All stages of a hand-eye calibration."""

    first: First
    boards: Array  # (views, 4, 4) camera_from_board of the views of `first`
    closed: closed_forms.HandEye
    keep: Mask  # (views,) which views of `first` the closed form agrees with
    fit: outliers.Fit
    latency: Latency | None = None  # of the pictures' time stamps, where it was measured

    @property
    def left_out(self) -> dict[str, str]:
        """Views that did not take part in the end, and why."""
        grossly = {o.name: "arm and picture disagree grossly" for o in self.first.session.chosen(~self.keep).observations}
        return {**self.first.left_out, **grossly, **self.fit.left_out}


def solve(session: TargetSession, given: Calibration | None = None, accuracy: Accuracy = STATED, lens: str = "auto") -> Solution:
    """All stages up to the refinement; arguments and errors are those of `calibrate_handeye`.

    Of a ROS bag also the latency of the pictures' time stamps. Views of a resting arm do not depend on it. Those of a moving one
    get the poses at their exposures, again until the latency stays.
    """
    _check_poses(session)
    links.check(session, accuracy)
    first = first_stage(session, given, lens)
    if (clocked := first.session.clocked) is None:
        return _solve_from(first, accuracy)
    start, rounds = latency.guess(first.session, first.camera), 1 if clocked.halts else LATENCY_ROUNDS
    while True:
        solution = _solve_from(replace(first, session=first.session.at_exposure(start)), accuracy)
        found, rounds = latency.find(solution.fit, first.free, start), rounds - 1
        if found is None or not rounds or abs(found.seconds - start) < LATENCY_SETTLED * found.std:
            return replace(solution, latency=found)
        start = found.seconds


def _solve_from(first: First, accuracy: Accuracy) -> Solution:
    """The stages from the first on."""
    boards = estimate.camera_from_boards(first.camera, first.session.observations)
    misread.explain(first.session, boards)
    names = [observation.name for observation in first.session.observations]
    order.explain(
        first.session.stand_from_mount, flips.readings(first.session, boards), names, list(first.session.images) or None
    )
    chosen, boards = flips.resolve(first.session, boards)
    first = replace(first, session=chosen)
    closed, keep = _closed_form(first.session, boards)
    start, chosen = start_from(first.camera, closed, int(keep.sum()), first.session.links.count), first.session.chosen(keep)
    options = {"sigma_px": first.sigma_px, "form": projection.form(first.camera)}
    fit = outliers.refine_without(chosen, start, first.free, first.known, accuracy, **options)
    return Solution(first, boards, closed, keep, fit)


def start_from(camera: Camera, closed: closed_forms.HandEye, views: int, joints: int = 6) -> State:
    """Where the refinement of a number of views of an arm with so many joints begins."""
    return State(
        projection.vector(camera), closed.mount_from_camera, closed.stand_from_board, np.zeros((views, 6)), np.zeros(4 * joints)
    )


def _check_poses(session: TargetSession) -> None:
    """Raise CalibrationError where a pose of the arm is not finite or impossibly far away."""
    for observation, base_from_flange in zip(session.observations, session.base_from_flange, strict=True):
        if not (np.isfinite(base_from_flange).all() and np.abs(base_from_flange[:3, 3]).max() < MAX_DISTANCE_M):
            where, why = f"view {observation.name}", f"its position is {base_from_flange[:3, 3].tolist()} m"
            raise CalibrationError("arm's pose is not credible", where=where, why=why, remedy="leave this view out")


def _closed_form(session: TargetSession, boards: Array) -> tuple[closed_forms.HandEye, Mask]:
    """A start and the views that agree with it. Raises CalibrationError for weak motion and for mistakes in the arm's poses."""
    try:
        uncertainty.check_motion(session.base_from_flange)
        closed, keep = closed_forms.solve_robustly(session.stand_from_mount, boards)
    except CalibrationError:
        mistakes.explain(session.stand_from_mount, boards)
        raise
    mistakes.explain(session.stand_from_mount, boards)
    return closed, keep


def first_stage(
    session: TargetSession, given: Calibration | None, lens: str = "auto", least_views: int = estimate.MIN_VIEWS
) -> First:
    """The camera to start from, and the views with plausible corners. `least_views` is for a camera that is `given`."""
    if given is None:
        found = _intrinsics(session, lens)
        chosen = session.with_observations(found.observations)
        known = knots(found.camera, found.lens.free, chosen)
        return First(chosen, found.camera, found.lens.free, known, found.sigma_px, found.left_out)
    verify.check_size(session, given.camera)
    observations, left_out = screening.agreeing_with_plane(session.observations)
    session = session.with_observations(observations)
    estimate.check_enough(observations, CORNERS_PER_VIEW * least_views, least_views)
    every = (*projection.NAMES, *projection.knot_names(projection.form(given.camera).grid))
    free = tuple(name for name in every if given.camera_std.get(name, 0) > 0)
    counted = [given.provenance.get("frames_sha256", ""), *given.provenance.get("together_sha256", ())]
    same = session.provenance.get("frames_sha256") in counted
    boards = estimate.camera_from_boards(given.camera, observations)
    pairs = zip(boards, observations, strict=True)
    residuals = np.concatenate([estimate.reproject(given.camera, board, o) - o.pixels for board, o in pairs])
    sigma_px = max(float(np.median(np.abs(residuals))) * 1.4826, 1e-3)
    known = knots(given.camera, free, session) if same or not free else _known(given, free)
    return First(session, given.camera, free, known, sigma_px, left_out)


def _known(given: Calibration, free: tuple[str, ...]) -> IntrinsicsPrior:
    """Intrinsics of another session with their covariance; independent where the file lacks their correlation."""
    std, stored = np.array([given.camera_std[name] for name in free]), given.residuals.camera_correlation
    among = np.eye(len(free))
    if stored is not None and set(free) <= set(stored.names):
        values, vectors = np.linalg.eigh(stored.among(free))  # rounded in the file: kept positive definite
        among = (vectors * np.maximum(values, 1e-6)) @ vectors.T
    return IntrinsicsPrior(free, projection.vector(given.camera)[projection.columns(free)], among * np.outer(std, std))


def finished(solution: Solution, accuracy: Accuracy, given: bool, allow_m: float = uncertainty.MAX_STD_M) -> Calibration:
    """The calibration with its uncertainty, its held-out errors and its provenance."""
    uncertainty.covariance(solution.fit.measured, solution.fit.refined, allow_m)
    return described(solution, repeating.estimate(solution.fit.measured, solution.fit.refined), accuracy, given, allow_m)


def described(solution: Solution, arm: repeating.Repeating, accuracy: Accuracy, given: bool, allow_m: float) -> Calibration:
    """The calibration of a solution and what is known of the arm, the covariance among it."""
    first, closed, fit, left_out = solution.first, solution.closed, solution.fit, solution.left_out
    session, measured, refined = fit.session, fit.measured, fit.refined
    late = solution.latency
    covariance = arm.covariance if late is None else arm.covariance + late.spread()
    covariance = uncertainty.checked(measured, refined, covariance, allow_m)
    camera_pose, board_pose = uncertainty.poses(measured, refined, covariance)
    free, link_errors = first.free, links.found(measured, refined, covariance)
    seems = flatness.asked_for(measured, refined)
    residuals = Residuals(
        rms_px=refined.rms_px,
        **verify.held_out(measured, refined),
        settled=refined.settled,
        sigma_px=refined.sigmas.pixel,
        arm_translation_mm=1e3 * refined.sigmas.translation_m,
        arm_rotation_deg=float(np.rad2deg(refined.sigmas.rotation_rad)),
        **arm.facts(),
        **_views(session, len(session.observations), left_out),
        corners=int(refined.inliers.sum()),
        corners_left_out=int((~refined.inliers).sum()),
        coverage=estimate.coverage(session.observations, session.width, session.height),
        view_rms_px=_by_view(session, measured, refined),
        closed_form=_closed_form_facts(closed, refined),
        allowed_mm=1e3 * allow_m if allow_m > uncertainty.MAX_STD_M else None,
        camera_correlation=Correlation.of(free, covariance[: len(free), : len(free)]) if free else None,
        rig_correlation=Correlation.of(tuple(uncertainty.parameter_names(measured)), covariance),
        target_seems=None if seems is None else seems.tolist(),
        **surface.facts(measured, refined, covariance),
        **(links.facts(measured, refined, link_errors) if link_errors is not None else {}),
        **({} if late is None else late.facts()),
    )
    credible.check(residuals, accuracy)
    provenance = {
        **session.provenance,
        "method": "hand-eye",
        "closed_form": closed.method,
        "intrinsics_given": given,
        "eye_to_hand": session.eye_to_hand,
        "arm_accuracy_stated": accuracy.to_json(),
    }
    return Calibration(
        projection.with_vector(first.camera, refined.state.intrinsics).checked(where="estimated camera"),
        dict(zip(free, map(float, np.sqrt(np.diag(covariance))), strict=False)),
        residuals=residuals,
        provenance=provenance,
        link_errors=link_errors,
        region=session.region,
        **dict(zip(measured.pose_names, (camera_pose, board_pose), strict=True)),
    )


def _by_view(session: TargetSession, measured: Measurements, refined: Refined) -> dict[str, float]:
    """Rms [px] of the inliers by name of the view; views without inliers are missing."""
    return {
        o.name: verify.rms(refined.residuals[chosen])
        for i, o in enumerate(session.observations)
        if (chosen := refined.inliers & (measured.view == i)).any()
    }


def _closed_form_facts(closed: closed_forms.HandEye, refined: Refined) -> dict[str, Any]:
    """The closed form's residuals, and how far the refinement moved from it."""
    moved_mm, moved_deg = pose.rms_difference(closed.mount_from_camera, refined.state.mount_from_camera)
    return {
        "method": closed.method,
        "translation_residual_mm": 1e3 * float(np.sqrt(np.mean(closed.translation_residual_m**2))),
        "rotation_residual_deg": float(np.rad2deg(np.sqrt(np.mean(closed.rotation_residual_rad**2)))),
        "moved_mm": moved_mm,
        "moved_deg": moved_deg,
    }
