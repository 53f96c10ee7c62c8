"""What a page shows of a calibration: the recording that it was made from, fitted again, stage by stage."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib import calibrate
from calib.calibrate import Solution
from calib.errors import CalibrationError
from calib.handeye import verify
from calib.handeye.model import Accuracy
from calib.intrinsics import estimate, projection
from calib.page import figures
from calib.sessions.session import TargetSession, observe_recording
from datasets import pose
from datasets.calibration import Calibration
from datasets.core.errors import UsageError
from datasets.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sighting:
    """One view of the target."""

    name: str
    image: Path
    by_arm: Array
    """(4, 4) pose of the camera (of the board, where the camera stands beside the arm) in the base, by the arm's report [m]."""
    by_picture: Array
    """(4, 4) the same by what the picture shows [m]."""
    pixels: Array
    """(n, 2) corners that were found [px]."""
    residuals: dict[str, Array]
    """(n, 2) seen minus predicted [px], by stage."""
    left_out: str = ""
    """Why the view took no part."""

    def rms(self, stage: str) -> float:
        """Root mean square length of the residuals of a stage [px]."""
        return verify.rms(self.residuals[stage])


@dataclass(frozen=True)
class Evidence:
    """A calibration with its recording."""

    stages: tuple[str, ...]
    """What residuals there are of: before and after the refinement, or of the camera alone."""
    sightings: tuple[Sighting, ...]
    pictures: dict[str, bytes]
    """Figures as PNG files, by title."""
    notes: tuple[str, ...] = ()


BEFORE, AFTER, ALONE = "before refinement", "after refinement", "camera alone"


def recording_of(calibration: Calibration, given: Path | None) -> Path:
    """Folder of the recording that a calibration was made from. Raises UsageError where it is not known or not there."""
    path = given or Path(calibration.provenance.get("recording", ""))
    if not (path / "manifest.json").is_file():
        raise UsageError("the recording is not there", where=path, why="residuals and views cannot be shown",
                     remedy="give the folder as --recording")  # fmt: skip
    return path


def gather(calibration: Calibration, path: Path, *, seen: Callable[[str], None] = lambda words: None) -> Evidence:
    """Find the target in a recording again, and repeat the calibration on it.

    Args:
        calibration: as stored.
        path: the recording that it was made from.
        seen: called after each view with a few words on it.

    Raises:
        KoalaError: what `observe_recording` and `calibrate.solve` raise.
    """
    session = observe_recording(path, seen=seen)
    recording = Recording.open(path)
    images = {frame.name: recording.image_path(frame) for frame in recording.frames}
    same = session.provenance.get("frames_sha256") == calibration.provenance.get("frames_sha256")
    notes = () if same else ("this is not the recording that the calibration was made from",)
    if calibration.flange_from_camera is None and calibration.base_from_camera is None:
        return _of_camera(calibration, session, images, notes)
    stated = calibration.provenance.get("arm_accuracy_stated", {})
    degrees = np.deg2rad([stated.get("rotation_deg", 0.01), stated.get("joint_deg", 0.0)])
    accuracy = Accuracy(1e-3 * stated.get("translation_mm", 0.05), *map(float, degrees))
    given = calibration if calibration.provenance.get("intrinsics_given") else None
    return _of_rig(calibration, calibrate.solve(session, given, accuracy), images, notes)


def _of_camera(calibration: Calibration, session: TargetSession, images: dict[str, Path], notes: tuple[str, ...]) -> Evidence:
    boards = estimate.camera_from_boards(calibration.camera, session.observations)
    sightings = []
    for observation, camera_from_board in zip(session.observations, boards, strict=True):
        residuals = observation.pixels - estimate.reproject(calibration.camera, camera_from_board, observation)
        place = pose.inverse(camera_from_board)
        why = calibration.residuals.get("why_left_out", {}).get(observation.name, "")
        sightings.append(
            Sighting(observation.name, images[observation.name], place, place, observation.pixels, {ALONE: residuals}, why)
        )
    return Evidence((ALONE,), tuple(sightings), {}, notes)


def _of_rig(calibration: Calibration, solution: Solution, images: dict[str, Path], notes: tuple[str, ...]) -> Evidence:
    before = at_start(solution)
    pictures = {
        f"residuals {AFTER}": figures.residual_vectors(solution), f"residuals {BEFORE}": figures.residual_vectors(before),
        "coverage": figures.coverage(solution), "errors by view": figures.view_errors(solution), "rotations": figures.rotations(solution),
    }  # fmt: skip
    sightings = tuple(_sightings(calibration, solution, before, images))
    return Evidence((AFTER, BEFORE), sightings, pictures, notes)


def at_start(solution: Solution) -> Solution:
    """The solution with the residuals of the closed form, which the refinement started from: the arm is taken at its word."""
    fit = solution.fit
    state = replace(fit.refined.state, intrinsics=projection.vector(solution.first.camera), corrections=0 * fit.refined.state.corrections,
                    offsets=0 * fit.refined.state.offsets,
                    flange_from_camera=solution.closed.flange_from_camera, base_from_board=solution.closed.base_from_board)  # fmt: skip
    residuals, _ = verify.errors(fit.measured, state)
    return replace(solution, fit=replace(fit, refined=replace(fit.refined, state=state, residuals=residuals)))


def _sightings(calibration: Calibration, solution: Solution, before: Solution, images: dict[str, Path]) -> Iterator[Sighting]:
    fitted = {observation.name: index for index, observation in enumerate(solution.fit.session.observations)}
    session = solution.first.session
    if session.eye_to_hand:
        on_flange, in_base = calibration.flange_from_board, calibration.base_from_camera
    else:
        on_flange, in_base = calibration.flange_from_camera, calibration.base_from_board
    if on_flange is None or in_base is None:
        raise CalibrationError(
            "calibration and recording do not belong together", why="one has the camera on the flange, the other beside the arm"
        )
    for number, observation in enumerate(session.observations):
        base_from_flange, camera_from_board = session.base_from_flange[number], solution.boards[number]
        by_arm = base_from_flange @ on_flange.matrix
        by_picture = in_base.matrix @ (camera_from_board if session.eye_to_hand else pose.inverse(camera_from_board))
        residuals, pixels = {}, observation.pixels
        if observation.name in fitted:
            chosen = (solution.fit.measured.view == fitted[observation.name]) & solution.fit.refined.inliers
            pixels = solution.fit.measured.pixels[chosen]
            residuals = {AFTER: solution.fit.refined.residuals[chosen], BEFORE: before.fit.refined.residuals[chosen]}
        yield Sighting(observation.name, images[observation.name], by_arm, by_picture, pixels, residuals,
                       solution.left_out.get(observation.name, "" if residuals else "left out"))  # fmt: skip
