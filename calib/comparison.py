"""All methods on one session, judged by views held out of their fit, and all by the same corners.

Each method is fitted to four of five folds and predicts the corners of the fifth, with its own pose of the board and the
arm's poses as reported. A reconstruction has to expect this error. It is given twice: over every corner, and over those that
the refinement of all views kept, without the views and corners that it left out. Closed forms have the camera of all views.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from koala3d.calib import calibrate
from koala3d.calib.arrays import Array, Mask
from koala3d.calib.calibrate import STATED
from koala3d.calib.handeye import closed_forms, model, refine, verify
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.handeye.outliers import Fit
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import KoalaError


@dataclass(frozen=True)
class Judged:
    """One method."""

    name: str
    camera_pose: Array | None  # (4, 4) from all views; None if the method failed
    residual_mm: float  # rms disagreement of the board's place by view [mm]; the figure that is usually published
    residual_deg: float
    held_out_px: float  # over every corner of every view
    held_out_mm: float
    kept_px: float  # over the corners that the refinement kept
    kept_mm: float
    views: int  # that the method was fitted to


def compare(
    session: TargetSession, given: Calibration | None = None, accuracy: Accuracy = STATED, lens: str = "auto"
) -> list[Judged]:
    """Closed forms and refinement, on all views and without those that disagree.

    Raises what `calibrate.calibrate_handeye` raises.
    """
    solution = calibrate.solve(session, given, accuracy, lens)
    first, fit = solution.first, solution.fit
    session, boards, camera = first.session, solution.boards, first.camera
    measured = model.measured(session, first.free, first.known, accuracy, projection.form(camera))
    kept = _kept(session, measured, fit)
    rows = [_closed_form(name, session, boards, measured, kept, projection.vector(camera)) for name in closed_forms.METHODS]
    start = calibrate.start_from(camera, solution.closed, len(boards))
    refined = refine.refine(measured, start, sigma_px=first.sigma_px)
    every = np.ones(len(boards), bool)
    rows.append(_refined("refinement, all views", session, boards, measured, kept, refined, every))
    if len(fit.session.observations) < len(boards):
        used = {o.name for o in fit.session.observations}
        chosen = np.array([o.name in used for o in session.observations])
        rows.append(_refined("refinement, outliers left out", session, boards, measured, kept, fit.refined, chosen))
    return rows


def _kept(session: TargetSession, measured: Measurements, fit: Fit) -> Mask:
    """(n,) which corners of all views the refinement kept."""
    kept, numbers = np.zeros(len(measured.view), bool), {o.name: i for i, o in enumerate(fit.session.observations)}
    for i, observation in enumerate(session.observations):
        if observation.name in numbers:
            kept[measured.view == i] = fit.refined.inliers[fit.measured.view == numbers[observation.name]]
    return kept


def _refined(
    name: str, session: TargetSession, boards: Array, measured: Measurements, kept: Mask, refined: Refined, used: Mask
) -> Judged:
    """The refinement of the views that are `used` (views,), which also predicts the others."""
    views, pose_found = len(boards), refined.state.mount_from_camera
    start = replace(refined.state, corrections=np.zeros((views, 6)))

    def fit(seen: Mask) -> State:
        return refine.refine(measured.some((seen & used)[measured.view]), start, sigma_px=refined.sigmas.pixel, rounds=2).state

    residual = _residual(session.stand_from_mount[used], boards[used], pose_found)
    return Judged(name, pose_found, *residual, *_errors(measured, kept, fit), int(used.sum()))


def _errors(measured: Measurements, kept: Mask, fit: Callable[[Mask], State]) -> tuple[float, float, float, float]:
    """Held-out errors over every corner ([px], [mm]) and over those kept; NaN if a fold could not be fitted."""
    found = verify.predicted(measured, kept, fit)
    if found is None:
        return np.nan, np.nan, np.nan, np.nan
    (px, mm), (all_px, all_mm) = (tuple(np.nan if value is None else value for value in pair) for pair in found)
    return all_px, all_mm, px, mm


def _closed_form(name: str, session: TargetSession, boards: Array, measured: Measurements, kept: Mask, camera: Array) -> Judged:
    """A closed form on all views, and its held-out errors."""
    mount, views = session.stand_from_mount, len(boards)

    def fit(seen: Mask) -> State:
        part = closed_forms.solve(mount[seen], boards[seen], name)
        return State(camera, part.mount_from_camera, part.stand_from_board, np.zeros((views, 6)))

    try:
        answer = closed_forms.solve(mount, boards, name)
        errors = _errors(measured, kept, fit)
    except KoalaError:
        return Judged(name, None, *[np.nan] * 6, views)
    residual = _residual(mount, boards, answer.mount_from_camera)
    return Judged(name, answer.mount_from_camera, *residual, *errors, views)


def _residual(mount: Array, boards: Array, camera_pose: Array) -> tuple[float, float]:
    """Rms disagreement of the board's place by view about its mean ([mm], [deg]), as it is usually published."""
    places = mount @ camera_pose @ boards
    rotations = Rotation.from_matrix(places[:, :3, :3])
    angles = (rotations.mean().inv() * rotations).magnitude()
    distances = np.linalg.norm(places[:, :3, 3] - places[:, :3, 3].mean(0), axis=1)
    return 1e3 * float(np.sqrt(np.mean(distances**2))), float(np.rad2deg(np.sqrt(np.mean(angles**2))))


def markdown(rows: Sequence[Judged]) -> str:
    """A table with one row per method."""
    heads = ("method", "views", "x, y, z [mm]", "rotation vector [°]", "residual", "unseen views, all corners", "corners kept")
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for row in rows:
        if row.camera_pose is None:
            lines.append(f"| {row.name} | {row.views} | no answer | | | | |")
            continue
        place = ", ".join(f"{v:.2f}" for v in 1e3 * row.camera_pose[:3, 3])
        turn = ", ".join(f"{v:.2f}" for v in np.rad2deg(pose.rotation_vector(row.camera_pose)))
        lines.append(
            f"| {row.name} | {row.views} | {place} | {turn} | {row.residual_mm:.2f} mm, {row.residual_deg:.3f}° "
            f"| {row.held_out_px:.2f} px = {row.held_out_mm:.2f} mm | {row.kept_px:.2f} px = {row.kept_mm:.2f} mm |"
        )
    return "\n".join(lines)
