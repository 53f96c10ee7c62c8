"""Errors of the arm's links: of the zeros of its joints, or of all Denavit-Hartenberg parameters. What was found, what can be?

An error of a link moves the flange differently in every view, but by the same law. `calib.handeye.model` estimates the errors
with everything else. Their stated accuracy is their prior; one that the views do not determine stays at the prior and is named.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import refine, verify
from koala3d.calib.handeye.model import Accuracy, Measurements
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import LinkErrors

MAX_BUILT_M, MAX_BUILT_RAD = 0.05, float(np.deg2rad(3))
"""Largest credible distance of the flange from the nominal kinematics; beyond it, it is another arm or another pose."""
SHOWN = 0.7  # the views do not determine an error whose standard deviation is more than this share of its prior


def check(session: TargetSession, accuracy: Accuracy) -> None:
    """Raise CalibrationError where errors of the links are asked for and joint angles are missing, or not those of the poses."""
    if not (accuracy.joint_rad or accuracy.length_m or accuracy.angle_rad):
        return
    without = "leave --joint-deg, --link-mm and --link-deg away"
    if session.joints is None:
        remedy = f"{without}, or record with 'capture run'"
        raise CalibrationError("errors of the links cannot be estimated", why="the session holds no joint angles", remedy=remedy)
    if not are_those_of_the_poses(session.joints, session.base_from_flange, session.links):
        distance, angle = _apart(session.joints, session.base_from_flange, session.links)
        place = f"{1e3 * distance:.0f} mm and {np.rad2deg(angle):.1f} deg elsewhere"
        why = f"by the kinematics of the arm's model the flange is {place}"
        remedy = f"{without}: another arm has other kinematics"
        raise CalibrationError("joint angles are not those of the poses", why=why, remedy=remedy)


def are_those_of_the_poses(angles: Array, base_from_flange: Array, links: kinematics.Links) -> bool:
    """Whether (views, n) joint angles [rad] lead a nominal arm about to its (views, 4, 4) reported poses."""
    distance, angle = _apart(angles, base_from_flange, links)
    return distance <= MAX_BUILT_M and angle <= MAX_BUILT_RAD


def _apart(angles: Array, base_from_flange: Array, links: kinematics.Links) -> tuple[float, float]:
    """Median distance [m] and angle [rad] of the nominal arm's poses from the reported ones."""
    distance, angle = pose.difference(kinematics.forward(angles, links), base_from_flange)
    return float(np.median(distance)), float(np.median(angle))


def found(session: Measurements, refined: Refined, covariance: Array) -> LinkErrors | None:
    """The errors out of a refinement and the (p, p) covariance of its global parameters; None where none were asked for."""
    if not session.erring:
        return None
    std, first = np.zeros(4 * session.links.count), len(session.free)
    std[session.erring] = np.sqrt(np.diag(covariance)[first : first + len(session.erring)])
    return LinkErrors(refined.state.link_errors, std, session.links)


def facts(session: Measurements, refined: Refined, found: LinkErrors) -> dict[str, Any]:
    """For the calibration file: errors that the views do not determine, and the held-out error without any."""
    plain = replace(session, joints=None)
    start = replace(refined.state, link_errors=0 * refined.state.link_errors, corrections=0 * refined.state.corrections)
    without = verify.held_out(plain, refine.refine(plain, start, sigma_px=refined.sigmas.pixel))
    not_shown = [session.links.parameters[one] for one in session.erring if found.std[one] > SHOWN * session.link_std[one]]
    return {"links_not_shown": not_shown, **{f"{name}_without_link_errors": value for name, value in without.items()}}


def in_words(found: LinkErrors) -> list[tuple[str, str]]:
    """Name and values of each kind of error that was estimated, with standard deviations; `-` where one is zero by convention."""
    degrees, lines = float(np.rad2deg(1.0)), []
    kinds = (
        ("links, d", 1e3, 3, "mm"),
        ("links, a", 1e3, 3, "mm"),
        ("links, alpha", degrees, 4, "deg"),
        ("joints", degrees, 4, "deg"),
    )
    for kind, errors, std in zip(kinds, np.split(found.errors, 4), np.split(found.std, 4), strict=True):
        name, scale, digits, unit = kind
        pairs = zip(scale * errors, scale * std, strict=True)
        values = [f"{error:.{digits}f} ± {deviation:.{digits}f}" if deviation else "-" for error, deviation in pairs]
        if std.any():
            lines.append((name, f"off by {', '.join(values)} {unit}"))
    return lines
