"""Frames of a ROS bag at their exposures: their time stamps are late by what the calibration measured."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.recording import BAG, Frame, Recording
from koala3d.datasets.track import SPEEDS, Track


def at_exposure(recording: Recording, frames: Sequence[Frame], calibration: Calibration) -> tuple[list[Frame], list[str]]:
    """The frames with the poses at their exposures, and what is to be noted; of other recordings they stay as they are.

    Raises DatasetError: the calibration is of another base or flange, or corrects joint angles, which bags do not hold.
    """
    track = recording.track
    if track is None:
        return list(frames), []
    _check(recording, calibration)
    about = recording.part(BAG)
    notes = [str(note) for note in about.get("notes") or ()]
    if about.get("halts"):
        return list(frames), notes
    late, std = calibration.residuals.latency_s, calibration.residuals.latency_std_s
    if late is None or std is None:
        advice = "calibrate with a bag in which the arm moves while the board is in view"
        return list(frames), [*notes, f"the arm moved while pictures were taken, and their latency is not known: {advice}"]
    poses = track.at(track.seconds([frame.host_time_ns for frame in frames]) - late)
    said = f"poses are those {1e3 * late:.2f} ± {1e3 * std:.2f} ms before the pictures' time stamps: the calibration's latency"
    return [replace(frame, base_from_flange=one) for frame, one in zip(frames, poses, strict=True)], [*notes, said]


def speeds(recording: Recording, frames: Sequence[Frame], calibration: Calibration) -> dict[str, Any]:
    """For the provenance of a scene, how fast the camera moved at each view, by which a wrong latency is told; else empty."""
    track, hand_eye = recording.track, calibration.flange_from_camera
    if track is None or hand_eye is None or recording.part(BAG).get("halts"):
        return {}
    moments = track.seconds([frame.host_time_ns for frame in frames]) - (calibration.residuals.latency_s or 0.0)
    found = Track(track.times_ns, track.poses @ hand_eye.matrix).speed(moments)
    return {SPEEDS: {frame.name: np.round(one, 9).tolist() for frame, one in zip(frames, found, strict=True)}}


def _check(recording: Recording, calibration: Calibration) -> None:
    """Raise DatasetError where the calibration cannot be applied to the bag's poses."""
    if calibration.link_errors is not None:
        why, remedy = "a bag's poses have none", "calibrate without --joint-deg, --link-mm and --link-deg"
        raise DatasetError("calibration corrects joint angles", where=recording.path, why=why, remedy=remedy)
    about, stated = recording.part(BAG), calibration.provenance.get(BAG)
    for name in ("base", "flange"):
        if isinstance(stated, dict) and stated.get(name) != about.get(name):
            why = f"{about.get(name)} in the bag, {stated.get(name)} in the calibration's"
            remedy = "calibrate with a bag of the same frames"
            raise DatasetError(f"{name} is another frame than the calibration's", where=about.get("path"), why=why, remedy=remedy)
