"""From one target session for each camera to one calibration for each, and the poses between the cameras.

Each camera is calibrated alone first, which finds its lens, its outliers and a start. Then all are refined together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib import calibrate
from calib.arrays import Array, Indices
from calib.calibrate import STATED, Solution
from calib.cameras.model import Cameras, CamerasState
from calib.errors import CalibrationError
from calib.handeye import refine, repeating, uncertainty
from calib.handeye.model import Accuracy
from calib.handeye.refine import Refined
from calib.sessions.session import TargetSession
from calib.solver.elimination import covariance_of
from calib.solver.geometry import rms_difference
from datasets import pose
from datasets.calibration import Calibration, UncertainPose
from datasets.core.errors import UsageError

APART = 60.0
"""Squared distance of two poses of the target, over their covariances, from which on it was moved. Chance exceeds 39 once in a
million; errors of the arm that repeat are in both covariances, and need not be the same in both sessions."""
APART_M = 2e-4  # less is nobody's doing


@dataclass(frozen=True)
class Together:
    """What was found, in the order of the sessions."""

    calibrations: tuple[Calibration, ...]
    first_from_camera: tuple[UncertainPose, ...]  # of all cameras but the first
    stops: int
    shared: int  # stops at which more than one camera took a view


def calibrate_together(
    sessions: Sequence[TargetSession],
    names: Sequence[str],
    *,
    same_stops: bool = False,
    accuracy: Accuracy = STATED,
    lens: str = "auto",
    allow_m: float = uncertainty.MAX_STD_M,
) -> Together:
    """Calibrate cameras that look at one target which nobody has moved between the sessions.

    Args:
        names: of the sessions, for messages.
        same_stops: views of the same name were taken at the same stop of the arm.

    Raises:
        UsageError: fewer than two sessions, other targets, arms or mounts, or views of one name with other poses of the arm.
        TargetError, Unobservable, CalibrationError: what a camera alone raises, or the target was moved.
    """
    _check_alike(sessions, names)
    alone = [calibrate.solve(session, None, accuracy, lens) for session in sessions]
    _check_target(alone, names)
    problem, start = _joined(alone, names, same_stops)
    sigma_px = alone[0].fit.refined.sigmas.pixel
    refined = refine.refine(problem, start, sigma_px=sigma_px)
    arm = repeating.estimate(problem, refined)
    between = [_between(problem, refined.state, arm.covariance, camera) for camera in range(1, len(sessions))]
    found = []
    for camera, solution in enumerate(alone):
        columns = problem.columns_of(camera)
        own = replace(arm, covariance=arm.covariance[np.ix_(columns, columns)])
        fit = replace(solution.fit, refined=_own(problem, refined, own.covariance, camera))
        found.append(calibrate.described(replace(solution, fit=fit), own, accuracy, False, allow_m))
    taken = np.bincount(np.concatenate(problem.stops))
    return Together(tuple(found), tuple(between), len(taken), int((taken > 1).sum()))


def _check_alike(sessions: Sequence[TargetSession], names: Sequence[str]) -> None:
    if len(sessions) < 2:
        raise UsageError("one camera is calibrated by 'calib handeye'", why=f"{len(sessions)} session given")
    first = sessions[0]
    for session, name in zip(sessions[1:], names[1:], strict=True):
        if session.board.to_json() != first.board.to_json():
            raise UsageError("another target than the first session's", where=name, remedy="record all cameras with one target")
        if session.eye_to_hand != first.eye_to_hand:
            raise UsageError("one camera is on the flange and one beside the arm", where=name, remedy="calibrate each alone")
        if session.links.to_json() != first.links.to_json() or (session.joints is None) != (first.joints is None):
            raise UsageError("another arm than the first session's", where=name)


def _check_target(alone: Sequence[Solution], names: Sequence[str]) -> None:
    """Raise CalibrationError where the target has been moved between two sessions."""
    boards = []
    for solution in alone:
        measured, refined = solution.fit.measured, solution.fit.refined
        boards.append(uncertainty.poses(measured, refined, repeating.estimate(measured, refined).covariance)[1])
    for board, name in zip(boards[1:], names[1:], strict=True):
        twist = _twist(board.matrix @ pose.inverse(boards[0].matrix))
        squared = float(twist @ np.linalg.solve(board.covariance + boards[0].covariance, twist))
        millimetres, degrees = rms_difference(board.matrix, boards[0].matrix)
        if squared > APART and millimetres > 1e3 * APART_M:
            stated = np.hypot(board.total_std[0], boards[0].total_std[0])
            why = (
                f"{names[0]} and {name} put it {millimetres:.3g} mm and {degrees:.3g} deg apart, where {stated:.2g} mm are stated"
            )
            remedy = "record all cameras without touching target or arm base; or calibrate each with 'calib handeye'"
            raise CalibrationError("the target was moved between the sessions", why=why, remedy=remedy)


def _twist(motion: Array) -> Array:
    """(6,) translation and rotation vector of a small (4, 4) motion."""
    return np.concatenate([motion[:3, 3], pose.rotation_vector(motion[:3, :3])])


def _joined(alone: Sequence[Solution], names: Sequence[str], same_stops: bool) -> tuple[Cameras, CamerasState]:
    """The problem and where its refinement begins."""
    fits = [solution.fit for solution in alone]
    noise = tuple(fit.refined.sigmas.pixel / fits[0].refined.sigmas.pixel for fit in fits)
    stops = _same_stops(alone, names) if same_stops else _own_stops(alone)
    problem = Cameras(tuple(fit.measured for fit in fits), stops, noise)
    states = [fit.refined.state for fit in fits]
    corrections = np.zeros((1 + max(int(one.max()) for one in stops), 6))
    first = states[0]
    return problem, CamerasState(
        tuple(state.intrinsics for state in states),
        tuple(state.mount_from_camera for state in states),
        first.stand_from_board,
        corrections,
        first.offsets,
        first.shape,
    )


def _own_stops(alone: Sequence[Solution]) -> tuple[Indices, ...]:
    """Every view of every camera at a stop of its own."""
    counts = [len(solution.fit.session.observations) for solution in alone]
    ends = np.cumsum(counts)
    return tuple(np.arange(end - count, end) for count, end in zip(counts, ends, strict=True))


def _same_stops(alone: Sequence[Solution], names: Sequence[str]) -> tuple[Indices, ...]:
    """Views of one name at one stop. Raises UsageError where the arm reported different poses for them, or none is shared."""
    places: dict[str, tuple[int, Array]] = {}
    found, shared = [], 0
    for solution, name in zip(alone, names, strict=True):
        session, own = solution.fit.session, []
        for observation, base_from_flange in zip(session.observations, session.base_from_flange, strict=True):
            number, known = places.setdefault(observation.name, (len(places), base_from_flange))
            shared += known is not base_from_flange
            if not np.allclose(known, base_from_flange, rtol=0, atol=1e-9):
                why = f"view {observation.name}: the arm reported another pose than in {names[0]}"
                remedy = "leave out --same-stops for sessions that were recorded one after the other"
                raise UsageError("views of one name were not taken at one stop", where=name, why=why, remedy=remedy)
            own.append(number)
        found.append(np.array(own))
    if not shared:
        raise UsageError("no view has a name in two sessions", where=names[1], remedy="leave out --same-stops")
    return tuple(found)


def _own(problem: Cameras, refined: Refined[CamerasState], covariance: Array, camera: int) -> Refined[Any]:
    """One camera's part of what was found together; `covariance` is that of its own unknowns."""
    corners, noise = problem.corners_of(camera), problem.noise[camera]
    return replace(
        refined,
        state=refined.state.of(camera, problem.stops[camera]),
        sigmas=replace(refined.sigmas, pixel=refined.sigmas.pixel * noise),
        information=covariance_of(covariance),
        residuals=refined.residuals[corners] * noise,
        inliers=refined.inliers[corners],
    )


def _between(problem: Cameras, state: CamerasState, covariance: Array, camera: int) -> UncertainPose:
    """The pose of a camera in the first one's frame: what both mounts have in common drops out of its uncertainty."""
    first_from_mount = pose.inverse(state.mount_from_camera[0])
    of_first, of_camera = (problem.columns_of(one)[-12:-6] for one in (0, camera))
    by_mount = _adjoint(first_from_mount)
    by_both = np.concatenate([-by_mount, by_mount], 1)  # of the first mount's error, and of this one's
    columns = [*of_first, *of_camera]
    spread = by_both @ covariance[np.ix_(columns, columns)] @ by_both.T
    return UncertainPose(first_from_mount @ state.mount_from_camera[camera], spread)


def _adjoint(a_from_b: Array) -> Array:
    """(6, 6) matrix that takes a small motion, translation first, from axes and origin of b to those of a."""
    turn, (x, y, z) = a_from_b[:3, :3], a_from_b[:3, 3]
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = turn
    found[:3, 3:] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
    return found
