"""From a target session to a calibration: intrinsics alone, or the whole rig.

Hand-eye calibration goes: pose of the board in each view -> closed form (which also finds views that disagree) ->
joint refinement -> covariance -> error on views that the refinement has not seen.
"""

from typing import Any

import numpy as np

from calib import handeye, intrinsics, projection, refine, uncertainty, verify
from calib.model import Accuracy, Session, State
from calib.refine import Refined
from calib.session import TargetSession
from datasets import pose
from datasets.calibration import Calibration
from datasets.camera_model import Camera

STATED = Accuracy()
"""What a UR5e is taken to keep within, where nobody says otherwise."""


def calibrate_intrinsics(session: TargetSession) -> Calibration:
    """Intrinsics from the pictures alone. Raises what `calib.intrinsics.calibrate` raises."""
    found = intrinsics.calibrate(session.observations, session.width, session.height)
    residuals = {
        "rms_px": found.rms_px, "held_out_px": found.held_out_px, "views_used": len(session.observations),
        "views_unseen": list(session.unseen), "corners": sum(len(o.ids) for o in session.observations),
        "coverage": found.coverage, "view_rms_px": found.view_rms_px,
    }  # fmt: skip
    return Calibration(found.camera, found.std, residuals=residuals, provenance={**session.provenance, "method": "intrinsics"})


def calibrate_handeye(session: TargetSession, given: Calibration | None = None, accuracy: Accuracy = STATED) -> Calibration:
    """Hand-eye pose, board pose and intrinsics together.

    Args:
        given: intrinsics from another session; they enter with their standard deviations. From the same session they are
            only the start, since its corners must not count twice.
        accuracy: of the arm, as stated.

    Raises:
        TargetError, Unobservable, CalibrationError: too few views, motion that leaves something undetermined, no fit.
        Misuse: `given` is for images of another size.
    """
    intrinsics.check_enough(session.observations)
    uncertainty.check_motion(session.base_from_flange)
    camera, free, known, sigma_px = _start_camera(session, given)
    boards = np.stack([intrinsics.camera_from_board(camera, o) for o in session.observations])
    closed, keep = handeye.solve_robustly(session.base_from_flange, boards)
    left_out = [o.name for o, kept in zip(session.observations, keep, strict=True) if not kept]
    session = session.chosen(keep)
    intrinsics.check_enough(session.observations)
    uncertainty.check_motion(session.base_from_flange)

    measured = session.measured(free, known, accuracy)
    start = State(projection.vector(camera), closed.flange_from_camera, closed.base_from_board, np.zeros((keep.sum(), 6)))
    refined = refine.refine(measured, start, sigma_px=sigma_px)
    joint = uncertainty.covariance(measured, refined)
    flange_from_camera, base_from_board = uncertainty.poses(measured, refined, joint)
    deviations = np.sqrt(np.diag(joint))
    residuals = {
        "rms_px": refined.rms_px, **verify.held_out(measured, refined), "settled": refined.settled, "sigma_px": refined.sigmas.pixel,
        "arm_translation_mm": 1e3 * refined.sigmas.translation_m, "arm_rotation_deg": float(np.rad2deg(refined.sigmas.rotation_rad)),
        "views_used": len(session.observations), "views_unseen": list(session.unseen), "views_left_out": left_out,
        "corners": int(refined.inliers.sum()), "corners_left_out": int((~refined.inliers).sum()),
        "coverage": intrinsics.coverage(session.observations, session.width, session.height),
        "view_rms_px": _by_view(session, measured, refined),
        "closed_form": _closed_form(closed, refined),
    }  # fmt: skip
    provenance = {
        **session.provenance, "method": "hand-eye", "closed_form": closed.method, "intrinsics_given": given is not None,
        "arm_accuracy_stated": {"translation_mm": 1e3 * accuracy.translation_m, "rotation_deg": float(np.rad2deg(accuracy.rotation_rad))},
    }  # fmt: skip
    return Calibration(
        projection.with_vector(camera, refined.state.intrinsics).checked(where="estimated camera"),
        dict(zip(free, map(float, deviations), strict=False)), flange_from_camera, base_from_board, residuals, provenance,
    )  # fmt: skip


def _start_camera(
    session: TargetSession, given: Calibration | None
) -> tuple[Camera, tuple[str, ...], dict[str, tuple[float, float]], float]:
    """Camera to start from, which intrinsics to estimate, what is known of them, and a corner's standard deviation [px]."""
    if given is None:
        found = intrinsics.calibrate(session.observations, session.width, session.height)
        return found.camera, tuple(found.std), {}, found.rms_px / np.sqrt(2)
    verify.check_size(session, given.camera)
    free = tuple(name for name in projection.NAMES if given.camera_std.get(name, 0) > 0)
    same = given.provenance.get("frames_sha256") == session.provenance.get("frames_sha256")
    known = {} if same else {name: (getattr(given.camera, name), given.camera_std[name]) for name in free}
    boards = [intrinsics.camera_from_board(given.camera, o) for o in session.observations]
    residuals = np.concatenate(
        [intrinsics.reproject(given.camera, b, o) - o.pixels for b, o in zip(boards, session.observations, strict=True)]
    )
    return given.camera, free, known, max(float(np.median(np.abs(residuals))) * 1.4826, 1e-3)


def _by_view(session: TargetSession, measured: Session, refined: Refined) -> dict[str, float]:
    """Rms [px] by name of the view, outliers left out; views of outliers alone are left out too."""
    return {
        o.name: verify.rms(refined.residuals[chosen])
        for i, o in enumerate(session.observations)
        if (chosen := refined.inliers & (measured.view == i)).any()
    }


def _closed_form(closed: handeye.HandEye, refined: Refined) -> dict[str, Any]:
    """What the closed form said, and how far the refinement moved from it."""
    distance, angle = pose.difference(closed.flange_from_camera, refined.state.flange_from_camera)
    return {
        "method": closed.method,
        "translation_residual_mm": 1e3 * float(np.sqrt(np.mean(closed.translation_residual_m**2))),
        "rotation_residual_deg": float(np.rad2deg(np.sqrt(np.mean(closed.rotation_residual_rad**2)))),
        "moved_mm": 1e3 * float(distance), "moved_deg": float(np.rad2deg(angle)),
    }  # fmt: skip
