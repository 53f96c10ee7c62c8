"""From sessions of one camera with several targets, or with one target in several places, to one calibration.

All pictures together give the lens. Each target is then calibrated alone, which finds outliers and a start. A target that too few
views show for that starts where the camera of the others sees it. Then all are refined together, with one camera and one arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array, Mask
from koala3d.calib.calibrate import STATED, Solution
from koala3d.calib.errors import TargetError, Unobservable
from koala3d.calib.handeye import closed_forms, flips, model, outliers, refine, repeating, uncertainty, verify
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.handeye.surface import FLAT
from koala3d.calib.intrinsics import estimate, projection
from koala3d.calib.intrinsics.fitting import rms
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.together import joining
from koala3d.calib.together.model import JointMeasurements, JointState
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core.errors import UsageError

HELD_OUT = ("held_out_px", "held_out_mm", "held_out_all_px", "held_out_all_mm")


@dataclass(frozen=True)
class Boards:
    """What was found; lists are in the order of the sessions."""

    calibration: Calibration  # its pose of the target is that of the session with the most corners
    stand_from_board: tuple[UncertainPose, ...]
    alone: tuple[UncertainPose | None, ...]  # the camera's pose by each session alone; None where it does not suffice


def calibrate_boards(
    sessions: Sequence[TargetSession],
    names: Sequence[str],
    recordings: Sequence[object],
    *,
    accuracy: Accuracy = STATED,
    lens: str = "auto",
    allow_m: float = uncertainty.MAX_STD_M,
) -> Boards:
    """Calibrate one camera by what it saw of several targets.

    Args:
        names: of the sessions, for messages and for the calibration file.
        recordings: what each session is from: views of one name in one recording were taken at one stop.

    Raises:
        UsageError: fewer than two sessions, other arms or mounts, or images of another size.
        Unobservable: no target alone determines the camera's pose.
        TargetError, CalibrationError: what a target alone raises, or the camera was moved in between.
    """
    _check_alike(sessions, names)
    pooled = _pooled(sessions)
    camera = calibrate.calibrate_intrinsics(pooled, lens)
    alone = [_alone(session, camera, accuracy) for session in sessions]
    mounts = [None if solution is None else joining.poses_alone(solution)[0] for solution in alone]
    _check_camera(mounts, names)
    best = max((one for one in alone if one is not None), key=lambda solution: len(solution.fit.measured.view))
    solutions = [one or _placed(session, best, camera, accuracy) for one, session in zip(alone, sessions, strict=True)]
    known = calibrate.knots(best.first.camera, best.first.free, pooled)
    problem, start = _joined(solutions, best, recordings, known)
    refined = refine.refine(problem, start, sigma_px=best.fit.refined.sigmas.pixel)
    arm = repeating.estimate(problem, refined)
    boards = _boards(problem, refined, arm.covariance)
    number = next(number for number, solution in enumerate(solutions) if solution is best)
    of_best = joining.calibration_of(problem, refined, arm, best, number, accuracy, allow_m)
    residuals = replace(
        of_best.residuals,
        rms_px=refined.rms_px,
        views_used=len(refined.state.corrections),
        corners=int(refined.inliers.sum()),
        corners_left_out=int((~refined.inliers).sum()),
        boards=_facts(names, solutions, problem, refined, boards),
        coverage=estimate.coverage(pooled.observations, pooled.width, pooled.height),
        **_held_out(problem, refined),
    )
    hashes = [session.provenance.get("frames_sha256") for session in sessions]
    provenance = {**of_best.provenance, "method": "hand-eye, several targets", "together_sha256": hashes}
    return Boards(replace(of_best, residuals=residuals, provenance=provenance), boards, tuple(mounts))


def _check_alike(sessions: Sequence[TargetSession], names: Sequence[str]) -> None:
    if len(sessions) < 2:
        raise UsageError("one target is what 'calib handeye' is for", why=f"{len(sessions)} session given")
    width, height = sessions[0].width, sessions[0].height
    for session, name in zip(sessions[1:], names[1:], strict=True):
        if (session.width, session.height) != (width, height):
            why = f"{session.width}x{session.height}, those of {names[0]} are {width}x{height}"
            raise UsageError("pictures have another size", where=name, why=why, remedy="record all with one camera setting")
    for session, name in zip(sessions, names, strict=True):
        if session.clocked is not None and not session.clocked.halts:
            why = "the arm never halts in it, and its latency is estimated from a bag alone"
            raise UsageError("cannot be calibrated with others", where=name, why=why, remedy="let the arm halt in each view")
    joining.check_arm(sessions, names)


def _check_camera(mounts: Sequence[UncertainPose | None], names: Sequence[str]) -> None:
    """Raise Unobservable where no session finds the camera's pose, CalibrationError where two of them find different ones."""
    found = [(mount, name) for mount, name in zip(mounts, names, strict=True) if mount is not None]
    if not found:
        remedy = "record at least one target from 10 views that are tilted about two axes"
        raise Unobservable("no target alone determines the hand-eye pose", why=f"{len(mounts)} sessions", remedy=remedy)
    remedy = "record all targets without touching the camera and its mount; or calibrate each with 'calib handeye'"
    joining.check_unmoved("camera", [mount for mount, _ in found], [name for _, name in found], remedy)


def _pooled(sessions: Sequence[TargetSession]) -> TargetSession:
    """The views of all sessions as one, for the lens: there every view has its own pose of the target anyway."""
    every = [
        replace(observation, name=f"{number}/{observation.name}")
        for number, session in enumerate(sessions)
        for observation in session.observations
    ]
    flanges = np.concatenate([session.base_from_flange for session in sessions])
    return replace(sessions[0], observations=tuple(every), base_from_flange=flanges, joints=None, readings=())


def _alone(session: TargetSession, camera: Calibration, accuracy: Accuracy) -> Solution | None:
    """One session with the lens of all as its start; None where its views do not determine the camera's pose."""
    try:
        return calibrate.solve(session, _start(camera, session), accuracy)
    except (Unobservable, TargetError):
        return None


def _start(camera: Calibration, session: TargetSession) -> Calibration:
    """`camera` as one that was estimated from the pictures of `session` itself: a start, which does not count twice."""
    return replace(camera, provenance={"frames_sha256": session.provenance.get("frames_sha256")})


def _placed(session: TargetSession, best: Solution, camera: Calibration, accuracy: Accuracy) -> Solution:
    """A session that does not suffice alone: the target is where the camera of `best` sees it."""
    first = calibrate.first_stage(session, _start(camera, session), least_views=1)
    lens, mount = best.fit.refined.state, best.fit.refined.state.mount_from_camera
    boards = estimate.camera_from_boards(first.camera, first.session.observations)
    stand_from_board = first.session.stand_from_mount[0] @ mount @ boards[0]
    chosen, boards = flips.as_placed(first.session, boards, mount, stand_from_board)
    closed = closed_forms.assess(chosen.stand_from_mount, boards, mount, "given")
    measured = model.measured(chosen, first.free, first.known, accuracy, projection.form(first.camera))
    still = np.zeros((len(boards), 6))
    start = replace(lens, stand_from_board=closed.stand_from_board, corrections=still, shape=FLAT)
    refined = refine.with_corrections(measured, refine.fit_board(measured, start), best.fit.refined.sigmas)
    fit = outliers.Fit(chosen, measured, refined, {})
    return Solution(replace(first, session=chosen), boards, closed, np.ones(len(boards), bool), fit)


def _joined(
    solutions: Sequence[Solution], best: Solution, recordings: Sequence[object], known: IntrinsicsPrior | None
) -> tuple[JointMeasurements, JointState]:
    """The problem and where its refinement begins. `known` is what is assumed of the lens."""
    fits, start = [solution.fit for solution in solutions], best.fit.refined.state
    stops = joining.stops([fit.session for fit in fits], recordings)
    measured = tuple(replace(fit.measured, known=known) for fit in fits)
    problem = JointMeasurements(measured, (0,) * len(fits), tuple(range(len(fits))), stops, (1.0,))
    states = [fit.refined.state for fit in fits]
    corrections = np.zeros((1 + max(int(one.max()) for one in stops), 6))
    boards, shapes = tuple(state.stand_from_board for state in states), tuple(state.shape for state in states)
    return problem, JointState((start.intrinsics,), (start.mount_from_camera,), boards, shapes, corrections, start.link_errors)


def _boards(problem: JointMeasurements, refined: Refined[JointState], covariance: Array) -> tuple[UncertainPose, ...]:
    """Pose of each target."""
    columns = [problem.columns_of(number)[-6:] for number in range(len(problem.sessions))]
    pairs = zip(refined.state.stand_from_board, columns, strict=True)
    return tuple(UncertainPose(board, covariance[np.ix_(own, own)]) for board, own in pairs)


def _held_out(problem: JointMeasurements, refined: Refined[JointState]) -> dict[str, float | None]:
    """Error on views whose stops the fit has not seen, over all sessions; keys are those of `verify.held_out`."""
    start = replace(refined.state, corrections=np.zeros_like(refined.state.corrections))
    squares, corners = np.zeros((2, 2)), np.zeros((2, 1))
    for number, session in enumerate(problem.sessions):

        def fitted(seen: Mask, number: int = number) -> State:
            unseen = problem.stops[number][~seen]
            some = problem.some(~np.isin(problem.view, unseen))
            return problem.state_of(refine.refine(some, start, sigma_px=refined.sigmas.pixel, rounds=2).state, number)

        kept = refined.inliers[problem.corners_of(number)]
        found = verify.predicted(session, kept, fitted)
        if found is None or None in found[0]:
            return dict.fromkeys(HELD_OUT)
        counts = np.array([[kept.sum()], [len(kept)]])
        squares, corners = squares + counts * np.array(found, np.float64) ** 2, corners + counts
    return dict(zip(HELD_OUT, np.sqrt(squares / corners).ravel().tolist(), strict=True))


def _facts(
    names: Sequence[str],
    solutions: Sequence[Solution],
    problem: JointMeasurements,
    refined: Refined[JointState],
    boards: Sequence[UncertainPose],
) -> list[dict[str, Any]]:
    """For the calibration file: each session's target, its pose, views, corners, rms [px], and views that were left out."""
    found = []
    for number, (name, solution, board) in enumerate(zip(names, solutions, boards, strict=True)):
        corners = problem.corners_of(number)
        kept = refined.inliers[corners]
        counts = {"views": len(problem.stops[number]), "corners": int(kept.sum()), "left_out": solution.left_out}
        error = rms(refined.residuals[corners][kept]) if kept.any() else None
        title = problem.sessions[number].pose_names[1]
        found.append({"name": name, **counts, "rms_px": error, title: board.to_json()})
    return found
