"""From one target session for each camera to one calibration for each, and the poses between the cameras.

Each camera is calibrated alone first, which finds its lens, its outliers and a start. Then all are refined together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array
from koala3d.calib.calibrate import STATED, Solution
from koala3d.calib.handeye import refine, repeating, uncertainty
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.together import joining
from koala3d.calib.together.model import JointMeasurements, JointState
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core.errors import UsageError


@dataclass(frozen=True)
class Cameras:
    """What was found, in the order of the sessions."""

    calibrations: tuple[Calibration, ...]
    first_from_camera: tuple[UncertainPose, ...]  # of all cameras but the first
    stops: int
    shared: int  # stops at which more than one camera took a view


def calibrate_cameras(
    sessions: Sequence[TargetSession],
    names: Sequence[str],
    *,
    same_stops: bool = False,
    accuracy: Accuracy = STATED,
    lens: str = "auto",
    allow_m: float = uncertainty.MAX_STD_M,
) -> Cameras:
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
    boards = [joining.poses_alone(solution)[1] for solution in alone]
    remedy = "record all cameras without touching target or arm base; or calibrate each with 'calib handeye'"
    joining.check_unmoved("target", boards, names, remedy)
    problem, start = _joined(alone, names, same_stops)
    sigma_px = alone[0].fit.refined.sigmas.pixel
    refined = refine.refine(problem, start, sigma_px=sigma_px)
    arm = repeating.estimate(problem, refined)
    between = [_between(problem, refined.state, arm.covariance, camera) for camera in range(1, len(sessions))]
    found = [
        joining.calibration_of(problem, refined, arm, solution, camera, accuracy, allow_m)
        for camera, solution in enumerate(alone)
    ]
    taken = np.bincount(np.concatenate(problem.stops))
    return Cameras(tuple(found), tuple(between), len(taken), int((taken > 1).sum()))


def _check_alike(sessions: Sequence[TargetSession], names: Sequence[str]) -> None:
    if len(sessions) < 2:
        raise UsageError("one camera is calibrated by 'calib handeye'", why=f"{len(sessions)} session given")
    for session, name in zip(sessions[1:], names[1:], strict=True):
        if session.board.to_json() != sessions[0].board.to_json():
            raise UsageError("another target than the first session's", where=name, remedy="record all cameras with one target")
    joining.check_arm(sessions, names)


def _joined(alone: Sequence[Solution], names: Sequence[str], same_stops: bool) -> tuple[JointMeasurements, JointState]:
    """The problem and where its refinement begins."""
    fits, sessions = [solution.fit for solution in alone], [solution.fit.session for solution in alone]
    noise = tuple(fit.refined.sigmas.pixel / fits[0].refined.sigmas.pixel for fit in fits)
    if same_stops:
        _check_stops(sessions, names)
    stops = joining.stops(sessions, [""] * len(fits) if same_stops else list(range(len(fits))))
    problem = JointMeasurements(tuple(fit.measured for fit in fits), tuple(range(len(fits))), (0,) * len(fits), stops, noise)
    states = [fit.refined.state for fit in fits]
    corrections = np.zeros((1 + max(int(one.max()) for one in stops), 6))
    first = states[0]
    return problem, JointState(
        tuple(state.intrinsics for state in states),
        tuple(state.mount_from_camera for state in states),
        (first.stand_from_board,),
        (first.shape,),
        corrections,
        first.link_errors,
    )


def _check_stops(sessions: Sequence[TargetSession], names: Sequence[str]) -> None:
    """Raise UsageError where the arm reported different poses for views of one name, or no view has a name in two sessions."""
    places: dict[str, Array] = {}
    shared = False
    for session, name in zip(sessions, names, strict=True):
        for observation, base_from_flange in zip(session.observations, session.base_from_flange, strict=True):
            known = places.setdefault(observation.name, base_from_flange)
            shared |= known is not base_from_flange
            if not np.allclose(known, base_from_flange, rtol=0, atol=1e-9):
                why = f"view {observation.name}: the arm reported another pose than in {names[0]}"
                remedy = "leave out --same-stops for sessions that were recorded one after the other"
                raise UsageError("views of one name were not taken at one stop", where=name, why=why, remedy=remedy)
    if not shared:
        raise UsageError("no view has a name in two sessions", where=names[1], remedy="leave out --same-stops")


def _between(problem: JointMeasurements, state: JointState, covariance: Array, camera: int) -> UncertainPose:
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
    turn = a_from_b[:3, :3]
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = turn
    found[:3, 3:] = pose.cross(a_from_b[:3, 3]) @ turn
    return found
