"""A stored calibration held against its recording: what pages show beside the file. No calibration is estimated here."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from koala3d.calib.arrays import Array, Indices, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import flips, model, refine, surface, verify
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import estimate, projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration

CORRECTED, REPORTED, ALONE = "arm corrected", "arm as reported", "camera alone"
"""Kinds of residuals: each view with the correction that its corners ask for; with the arm's pose as reported; without an arm."""


@dataclass(frozen=True)
class Sighting:
    """One view of the target."""

    name: str
    image: Path | None
    by_arm: Array
    """(4, 4) pose of the camera (of the board, where the camera stands beside the arm) in the base, by the arm's report [m]."""
    by_picture: Array  # (4, 4) the same by what the picture shows [m]
    pixels: Array  # (n, 2) corners that were found [px]
    residuals: dict[str, Array]  # (n, 2) seen minus predicted [px], by kind; none for a view that was left out
    left_out: str = ""

    def rms(self, kind: str) -> float:
        """Root mean square length of one kind of residuals [px]."""
        return verify.rms(self.residuals[kind])


@dataclass(frozen=True)
class CalibrationEvidence:
    """A stored calibration and a recording, corner by corner: n corners of the views that the calibration was made from."""

    calibration: Calibration
    everything: TargetSession  # all views that show the target
    boards: Array  # (all views, 4, 4) camera_from_board as seen
    session: TargetSession  # the views that took part in the calibration
    view: Indices  # (n,) index of each corner's view in `session`
    pixels: Array  # (n, 2) where the corners are seen [px]
    residuals: dict[str, Array]  # (n, 2) seen minus predicted [px], by kind; the most important kind first
    inliers: Mask  # (n,) corners that agree with the calibration
    corrections: Array | None
    """(views, 6) of the arm's reports: translation [m], rotation vector [rad]; None for a calibration of the camera alone."""

    @property
    def kind(self) -> str:
        """The most important kind of residuals."""
        return next(iter(self.residuals))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about the recording."""
        hashes = [source.provenance.get("frames_sha256") for source in (self.everything, self.calibration)]
        return () if hashes[0] == hashes[1] else ("this is not the recording that the calibration was made from",)

    @property
    def left_out(self) -> dict[str, str]:
        """Views that did not take part, and why."""
        return {name: "no target was found" for name in self.everything.unseen} | left_out(self.calibration)

    def sightings(self) -> Iterator[Sighting]:
        """Every view that shows the target."""
        session, index = self.everything, {o.name: i for i, o in enumerate(self.session.observations)}
        mount, stand = poses_of(self.calibration, session) if self.corrections is not None else (np.eye(4), np.eye(4))
        for number, observation in enumerate(session.observations):
            by_picture = self.boards[number] if session.eye_to_hand else pose.inverse(self.boards[number])
            by_arm = by_picture
            if self.corrections is not None:
                in_base, on_flange = (mount, stand) if session.eye_to_hand else (stand, mount)
                by_picture, by_arm = in_base @ by_picture, session.base_from_flange[number] @ on_flange
            own = self.inliers & (self.view == index.get(observation.name, -1))
            residuals = {kind: values[own] for kind, values in self.residuals.items()} if own.any() else {}
            pixels = self.pixels[own] if own.any() else observation.pixels
            why = self.left_out.get(observation.name, "" if residuals else "no corner agrees with the calibration")
            yield Sighting(observation.name, session.images.get(observation.name), by_arm, by_picture, pixels, residuals, why)


def left_out(calibration: Calibration) -> dict[str, str]:
    """Views that were left out of a calibration, and why."""
    reasons = calibration.residuals.why_left_out
    return {name: reasons.get(name, "left out") for name in calibration.residuals.views_left_out}


def poses_of(calibration: Calibration, session: TargetSession) -> tuple[Array, Array]:
    """(4, 4) mount_from_camera and stand_from_board, named as in `calib.handeye.model`. Raises CalibrationError."""
    mount = calibration.base_from_camera if session.eye_to_hand else calibration.flange_from_camera
    stand = calibration.flange_from_board if session.eye_to_hand else calibration.base_from_board
    if mount is None or stand is None:
        why = "one has the camera on the flange, the other beside the arm"
        raise CalibrationError("calibration and recording do not belong together", why=why)
    return mount.matrix, stand.matrix


def gather(calibration: Calibration, session: TargetSession) -> CalibrationEvidence:
    """Hold a stored calibration against a session.

    Raises UsageError for images of another size, CalibrationError where the recording does not fit the calibration at all.
    """
    verify.check_size(session, calibration.camera)
    boards = estimate.camera_from_boards(calibration.camera, session.observations)
    if calibration.poses:
        session, boards = flips.as_placed(session, boards, *poses_of(calibration, session))
    used = np.array([o.name not in left_out(calibration) for o in session.observations])
    if not used.any():
        raise CalibrationError("recording shows no view that the calibration was made from", remedy="give another --recording")
    chosen = session.chosen(used)
    measured = model.measured(chosen, (), None, Accuracy(), projection.form(calibration.camera))
    if not calibration.poses:
        predicted = [estimate.reproject(calibration.camera, b, o) for b, o in zip(boards[used], chosen.observations, strict=True)]
        found = {ALONE: measured.pixels - np.concatenate(predicted)}, np.ones(len(measured.view), bool), None
    else:
        errors = np.zeros(4 * session.links.count) if calibration.link_errors is None else calibration.link_errors.errors
        still = np.zeros((len(chosen.observations), 6))
        shape = surface.known(calibration.residuals)
        state = State(projection.vector(calibration.camera), *poses_of(calibration, session), still, errors, shape)
        refined = refine.with_corrections(measured, state, sigmas_of(calibration))
        plain = verify.errors(measured, replace(state, link_errors=0 * errors))[0]
        found = {CORRECTED: refined.residuals, REPORTED: plain}, refined.inliers, refined.state.corrections
    return CalibrationEvidence(calibration, session, boards, chosen, measured.view, measured.pixels, *found)


def sigmas_of(calibration: Calibration) -> refine.Sigmas:
    """The standard deviations that a calibration has estimated; the usual ones where its file does not hold them."""
    usual, found = Accuracy(), calibration.residuals
    translation_m = usual.translation_m if found.arm_translation_mm is None else 1e-3 * found.arm_translation_mm
    rotation_rad = usual.rotation_rad if found.arm_rotation_deg is None else float(np.deg2rad(found.arm_rotation_deg))
    sigma_px = (0.2 if found.rms_px is None else found.rms_px) / np.sqrt(2) if found.sigma_px is None else found.sigma_px
    return refine.Sigmas(sigma_px, translation_m, rotation_rad)
