"""All methods on one session, judged by views held out of their fit.

Each method is fitted to four of five folds and predicts the corners of the fifth, with its own pose of the board and the
arm's poses as reported. A reconstruction has to expect this error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib import calibrate
from calib.arrays import Array
from calib.calibrate import STATED
from calib.handeye import closed_forms, model, refine, verify
from calib.handeye.model import Accuracy, Session, State
from calib.handeye.refine import Refined
from calib.intrinsics import projection
from calib.sessions.session import TargetSession
from datasets import pose
from datasets.calibration import Calibration
from datasets.core.errors import KoalaError
from datasets.splits import folds


@dataclass(frozen=True)
class Judged:
    """One method."""

    name: str
    camera_pose: Array | None  # (4, 4) from all views; None if the method failed
    residual_mm: float  # rms disagreement of the board's place by view [mm]; the figure that is usually published
    residual_deg: float
    held_out_px: float
    held_out_mm: float
    views: int


def compare(
    session: TargetSession, given: Calibration | None = None, accuracy: Accuracy = STATED, lens: str = "auto"
) -> list[Judged]:
    """Closed forms and refinement, on all views and without those that disagree.

    Raises what `calibrate.calibrate_handeye` raises.
    """
    solution = calibrate.solve(session, given, accuracy, lens)
    first, fit = solution.first, solution.fit
    session, boards, camera = first.session, solution.boards, first.camera
    measured = model.measured(session, first.free, first.known, accuracy, camera.fisheye)
    rows = [_closed_form(name, session, boards, measured, projection.vector(camera)) for name in closed_forms.METHODS]
    start = calibrate.start_from(camera, solution.closed, len(boards))
    refined = refine.refine(measured, start, sigma_px=first.sigma_px)
    rows.append(_refined("refinement, all views", session, boards, measured, refined))
    if len(fit.session.observations) < len(boards):
        used = {o.name for o in fit.session.observations}
        kept = boards[[o.name in used for o in session.observations]]
        rows.append(_refined("refinement, outliers left out", fit.session, kept, fit.measured, fit.refined))
    return rows


def _refined(name: str, session: TargetSession, boards: Array, measured: Session, refined: Refined) -> Judged:
    pose_found = refined.state.mount_from_camera
    residual = _residual(session.stand_from_mount, boards, pose_found)
    held_out = verify.held_out(measured, refined)
    pixels, millimetres = (np.nan if value is None else value for value in (held_out["held_out_px"], held_out["held_out_mm"]))
    return Judged(name, pose_found, *residual, pixels, millimetres, len(boards))


def _closed_form(name: str, session: TargetSession, boards: Array, measured: Session, camera: Array) -> Judged:
    """A closed form on all views, and its held-out error."""
    mount, views = session.stand_from_mount, len(boards)
    try:
        answer = closed_forms.solve(mount, boards, name)
        errors = []
        for fold in range(verify.FOLDS):
            seen = folds(views, verify.FOLDS) != fold
            part = closed_forms.solve(mount[seen], boards[seen], name)
            state = State(camera, part.mount_from_camera, part.stand_from_board, np.zeros((views, 6)))
            rest = measured.some(~seen[measured.view])
            if len(rest.view):
                errors.append(verify.errors(rest, state))
    except KoalaError:
        return Judged(name, None, np.nan, np.nan, np.nan, np.nan, views)
    pixels, millimetres = (verify.rms(np.concatenate(parts)) for parts in zip(*errors, strict=True))
    residual = _residual(mount, boards, answer.mount_from_camera)
    return Judged(name, answer.mount_from_camera, *residual, pixels, millimetres, views)


def _residual(mount: Array, boards: Array, camera_pose: Array) -> tuple[float, float]:
    """Rms disagreement of the board's place by view about its mean ([mm], [deg]), as it is usually published."""
    places = mount @ camera_pose @ boards
    rotations = Rotation.from_matrix(places[:, :3, :3])
    angles = (rotations.mean().inv() * rotations).magnitude()
    distances = np.linalg.norm(places[:, :3, 3] - places[:, :3, 3].mean(0), axis=1)
    return 1e3 * float(np.sqrt(np.mean(distances**2))), float(np.rad2deg(np.sqrt(np.mean(angles**2))))


def markdown(rows: Sequence[Judged]) -> str:
    """A table with one row per method."""
    lines = ["| method | views | x, y, z [mm] | rotation vector [°] | residual | on unseen views |", "|---|---|---|---|---|---|"]
    for row in rows:
        if row.camera_pose is None:
            lines.append(f"| {row.name} | {row.views} | no answer | | | |")
            continue
        place = ", ".join(f"{v:.2f}" for v in 1e3 * row.camera_pose[:3, 3])
        turn = ", ".join(f"{v:.2f}" for v in np.rad2deg(pose.rotation_vector(row.camera_pose)))
        lines.append(
            f"| {row.name} | {row.views} | {place} | {turn} | {row.residual_mm:.2f} mm, {row.residual_deg:.3f}° "
            f"| {row.held_out_px:.2f} px = {row.held_out_mm:.2f} mm |"
        )
    return "\n".join(lines)
