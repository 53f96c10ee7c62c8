"""How well a calibration predicts pictures that it was not made from. A small residual of the fit does not show that."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import closed_forms, model, surface
from koala3d.calib.handeye.model import Accuracy, Measurements, State, camera_points, predict
from koala3d.calib.handeye.refine import Refined, fit_board, refine
from koala3d.calib.intrinsics import estimate, projection
from koala3d.calib.intrinsics.fitting import rms
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.splits import folds

FOLDS = 5  # parts into which a session is divided; each is predicted from the rest


@dataclass(frozen=True)
class Verification:
    """Errors of a calibration on a session, with arm poses as reported. Only the pose of the board is fitted."""

    rms_px: float  # between seen and predicted corner [px]
    rms_mm: float  # the same at the board, across the line of sight [mm]
    view_rms_px: dict[str, float]  # by name of the view [px]
    corners: int
    stand: str  # what carries the board: "base" or "flange"
    stand_from_board: Array  # (4, 4) as fitted

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        numbers = {k: v for k, v in vars(self).items() if not k.startswith("stand")}
        return {**numbers, f"{self.stand}_from_board": self.stand_from_board.tolist(), "views": len(self.view_rms_px)}


def verify(session: TargetSession, calibration: Calibration) -> Verification:
    """Predict the corners of a session. Raises UsageError for calibrations without a hand-eye pose or for other image sizes."""
    mount = calibration.base_from_camera if session.eye_to_hand else calibration.flange_from_camera
    if mount is None:
        raise UsageError("calibration holds no hand-eye pose", remedy="make one with 'calib handeye'")
    check_size(session, calibration.camera)
    session = _with_links_corrected(session, calibration)
    camera, stand = calibration.camera, "flange" if session.eye_to_hand else "base"
    boards = estimate.camera_from_boards(camera, session.observations)
    board = closed_forms.assess(session.stand_from_mount, boards, mount.matrix, "given").stand_from_board
    measured = model.measured(session, projection.NAMES, None, Accuracy(), projection.form(camera))
    same = calibration.provenance.get("board") == session.board.to_json()
    shape = surface.known(calibration.residuals) if same else surface.FLAT
    start = State(projection.vector(camera), mount.matrix, board, np.zeros((len(boards), 6)), shape=shape)
    state = fit_board(measured, start)
    residuals, millimetres = errors(measured, state)
    by_view = {o.name: rms(residuals[measured.view == i]) for i, o in enumerate(session.observations)}
    return Verification(rms(residuals), rms(millimetres), by_view, len(residuals), stand, state.stand_from_board)


def _with_links_corrected(session: TargetSession, calibration: Calibration) -> TargetSession:
    """The session with flange poses corrected by the links' errors of the calibration."""
    if calibration.link_errors is None:
        return session
    if session.joints is None:
        raise UsageError(
            "calibration holds errors of the links, the session no joint angles", remedy="calibrate without --link-mm"
        )
    return replace(session, base_from_flange=calibration.link_errors.corrected(session.base_from_flange, session.joints))


def held_out(session: Measurements, refined: Refined) -> dict[str, float | None]:
    """Error on held-out views, in up to five folds, of the corners that `refined` kept: `held_out_px`, `held_out_mm`; and of all
    corners: `held_out_all_px`, `held_out_all_mm`. None if a fold could not be fitted.

    The arm's poses are taken as reported, so these figures include the error of the arm, as in a reconstruction.
    """
    views = len(session.base_from_flange)
    start = replace(refined.state, corrections=np.zeros((views, 6)))

    def fitted(seen: Mask) -> State:
        return refine(session.some(seen[session.view]), start, sigma_px=refined.sigmas.pixel, rounds=2).state

    kept, every = predicted(session, refined.inliers, fitted) or ((None, None), (None, None))
    return {"held_out_px": kept[0], "held_out_mm": kept[1], "held_out_all_px": every[0], "held_out_all_mm": every[1]}


def predicted(
    session: Measurements, kept: Mask, fit: Callable[[Mask], State]
) -> tuple[tuple[float | None, float | None], tuple[float | None, float | None]] | None:
    """Rms errors ([px], [mm]) of predicted corners: of those `kept` (n,), and of all. None if a fold cannot be fitted.

    Every view is predicted by what `fit` finds in the views of other folds, (views,) true, with the arm's pose as reported.
    """
    views = len(session.base_from_flange)
    fold_of, pixels, millimetres = folds(views, FOLDS), np.zeros((len(session.view), 2)), np.zeros((len(session.view), 2))
    for fold in range(min(FOLDS, views)):
        unseen = (fold_of == fold)[session.view]
        if not unseen.any():
            continue
        try:
            state = fit(fold_of != fold)
            pixels[unseen], millimetres[unseen] = errors(session.some(unseen), replace(state, corrections=np.zeros((views, 6))))
        except CalibrationError:
            return None
    some = (rms(pixels[kept]), rms(millimetres[kept])) if kept.any() else (None, None)
    return some, (rms(pixels), rms(millimetres))


def check_size(session: TargetSession, camera: Camera) -> None:
    """Raise UsageError where `camera` is for images of another size than those of `session`."""
    if (camera.width, camera.height) != (session.width, session.height):
        where, remedy = session.provenance.get("recording", ""), "calibrate with the camera setting of the recording"
        why = f"{camera.width}x{camera.height}, the recording has {session.width}x{session.height}"
        raise UsageError("calibration is for images of another size", where=where, why=why, remedy=remedy)


def errors(session: Measurements, state: State) -> tuple[Array, Array]:
    """(n, 2) seen minus predicted [px], and the same at the corner's depth [mm]."""
    residuals = session.pixels - predict(session, state)[0]
    depth = camera_points(session, state)[:, 2:]
    return residuals, 1e3 * residuals * depth / state.intrinsics[:2]
