"""Joint offsets of the arm: true angle minus reported angle. Can they be estimated, and what was found?

An offset moves the flange differently in every view, but by the same law. `calib.handeye.model` estimates the offsets of all
joints but the first and the last with everything else. The stated accuracy of the joints is their prior; an offset that the
views do not determine stays at the prior and is reported as such.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from calib.arrays import Array
from calib.errors import CalibrationError
from calib.handeye import refine, verify
from calib.handeye.model import Accuracy, Session
from calib.handeye.refine import Refined
from calib.sessions.session import TargetSession
from datasets import kinematics, pose
from datasets.calibration import JointOffsets

MAX_BUILT_M, MAX_BUILT_RAD = 0.05, float(np.deg2rad(3))
"""Largest credible distance of the flange from the nominal kinematics; beyond it, it is another arm or another pose."""
SHOWN = 0.7  # the views do not determine an offset whose standard deviation is more than this share of its prior


def check(session: TargetSession, accuracy: Accuracy) -> None:
    """Raise CalibrationError where joint offsets are requested and the joint angles are missing or do not match the poses."""
    if accuracy.joint_rad == 0:
        return
    if session.joints is None:
        remedy = "leave --joint-deg away, or record with 'capture run'"
        raise CalibrationError("joint offsets cannot be estimated", why="the session holds no joint angles", remedy=remedy)
    if not are_those_of_the_poses(session.joints, session.base_from_flange, session.links):
        distance, angle = _apart(session.joints, session.base_from_flange, session.links)
        place = f"{1e3 * distance:.0f} mm and {np.rad2deg(angle):.1f} deg elsewhere"
        why = f"by the kinematics of the arm's model the flange is {place}"
        remedy = "leave --joint-deg away: another arm has other kinematics"
        raise CalibrationError("joint angles are not those of the poses", why=why, remedy=remedy)


def are_those_of_the_poses(angles: Array, base_from_flange: Array, links: kinematics.Links) -> bool:
    """Whether (views, n) joint angles [rad] lead a nominal arm about to its (views, 4, 4) reported poses."""
    distance, angle = _apart(angles, base_from_flange, links)
    return distance <= MAX_BUILT_M and angle <= MAX_BUILT_RAD


def _apart(angles: Array, base_from_flange: Array, links: kinematics.Links) -> tuple[float, float]:
    """Median distance [m] and angle [rad] of the nominal arm's poses from the reported ones."""
    distance, angle = pose.difference(kinematics.forward(angles, links), base_from_flange)
    return float(np.median(distance)), float(np.median(angle))


def found(session: Session, refined: Refined, covariance: Array) -> JointOffsets | None:
    """The offsets out of a refinement and the (p, p) covariance of its global parameters; None where none were asked for."""
    if not session.turning:
        return None
    std, first = np.zeros(session.links.count), len(session.free)
    std[session.turning] = np.sqrt(np.diag(covariance)[first : first + len(session.turning)])
    return JointOffsets(refined.state.offsets, std, session.links)


def facts(session: Session, refined: Refined, offsets: JointOffsets) -> dict[str, Any]:
    """For the calibration file: joints whose offsets the views do not determine, and the held-out error without offsets."""
    stated = session.accuracy.joint_rad
    plain = replace(session, joints=None)
    start = replace(refined.state, offsets=0 * refined.state.offsets, corrections=0 * refined.state.corrections)
    without = verify.held_out(plain, refine.refine(plain, start, sigma_px=refined.sigmas.pixel))
    not_shown = [joint + 1 for joint in session.turning if offsets.std[joint] > SHOWN * stated]
    return {"joints_not_shown": not_shown, **{f"{name}_without_joint_offsets": value for name, value in without.items()}}
