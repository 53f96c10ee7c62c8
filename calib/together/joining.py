"""What sessions that are calibrated together must have in common, and each one's part of the common answer."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array, Indices
from koala3d.calib.calibrate import Solution
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import repeating, uncertainty
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.solver.elimination import covariance_of
from koala3d.calib.together.model import JointMeasurements, JointState
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core.errors import UsageError

APART = 60.0
"""Squared distance of two poses, over their covariances, from which on something was moved. Chance exceeds 39 once in a million;
errors of the arm that repeat are in both covariances, and need not be the same in both sessions."""
APART_M = 2e-4  # less is nobody's doing


def check_arm(sessions: Sequence[TargetSession], names: Sequence[str]) -> None:
    """Raise UsageError where two sessions are of different arms, or of different ways to mount the camera."""
    first = sessions[0]
    for session, name in zip(sessions[1:], names[1:], strict=True):
        if session.eye_to_hand != first.eye_to_hand:
            raise UsageError("one camera is on the flange and one beside the arm", where=name, remedy="calibrate each alone")
        if session.links.to_json() != first.links.to_json() or (session.joints is None) != (first.joints is None):
            raise UsageError("another arm than the first session's", where=name)


def poses_alone(solution: Solution) -> tuple[UncertainPose, UncertainPose]:
    """(mount_from_camera, stand_from_board) as one session alone finds them."""
    measured, refined = solution.fit.measured, solution.fit.refined
    return uncertainty.poses(measured, refined, repeating.estimate(measured, refined).covariance)


def check_unmoved(what: str, found: Sequence[UncertainPose], names: Sequence[str], remedy: str) -> None:
    """Raise CalibrationError where a session puts something elsewhere than the first one does."""
    for placed, name in zip(found[1:], names[1:], strict=True):
        twist = _twist(placed.matrix @ pose.inverse(found[0].matrix))
        squared = float(twist @ np.linalg.solve(placed.covariance + found[0].covariance, twist))
        millimetres, degrees = pose.rms_difference(placed.matrix, found[0].matrix)
        if squared > APART and millimetres > 1e3 * APART_M:
            stated = np.hypot(placed.total_std[0], found[0].total_std[0])
            why = (
                f"{names[0]} and {name} put it {millimetres:.3g} mm and {degrees:.3g} deg apart, where {stated:.2g} mm are stated"
            )
            raise CalibrationError(f"the {what} was moved between the sessions", why=why, remedy=remedy)


def stops(sessions: Sequence[TargetSession], recordings: Sequence[object]) -> tuple[Indices, ...]:
    """Views of one name that are of one recording are at one stop, any other at a stop of its own."""
    places: dict[tuple[object, str], int] = {}
    pairs = zip(sessions, recordings, strict=True)
    return tuple(np.array([places.setdefault((one, o.name), len(places)) for o in s.observations]) for s, one in pairs)


def _own_part(problem: JointMeasurements, refined: Refined[JointState], covariance: Array, number: int) -> Refined[Any]:
    """One session's part of what was found together; `covariance` is that of its own unknowns."""
    corners, noise = problem.corners_of(number), problem.noise[problem.cameras[number]]
    return replace(
        refined,
        state=problem.state_of(refined.state, number),
        sigmas=replace(refined.sigmas, pixel=refined.sigmas.pixel * noise),
        information=covariance_of(covariance),
        residuals=refined.residuals[corners] * noise,
        inliers=refined.inliers[corners],
    )


def calibration_of(
    problem: JointMeasurements,
    refined: Refined[JointState],
    arm: repeating.Repeating,
    solution: Solution,
    number: int,
    accuracy: Accuracy,
    allow_m: float,
) -> Calibration:
    """What was found together, as the calibration of one session whose own `solution` was the start."""
    columns = problem.columns_of(number)
    own = replace(arm, covariance=arm.covariance[np.ix_(columns, columns)])
    part = _own_part(problem, refined, own.covariance, number)
    fit = replace(solution.fit, measured=problem.sessions[number], refined=part)
    return calibrate.described(replace(solution, fit=fit), own, accuracy, False, allow_m)


def _twist(motion: Array) -> Array:
    """(6,) translation and rotation vector of a small (4, 4) motion."""
    return np.concatenate([motion[:3, 3], pose.rotation_vector(motion[:3, :3])])
