"""Comparison with the ground truth of a simulation. Only evaluation reads RECORDING/truth."""

from pathlib import Path
from typing import Any

import numpy as np

from datasets import pose
from datasets.calibration import Calibration
from datasets.core import files
from datasets.core.errors import UsageError
from datasets.recording import TRUTH, Recording

POSES = "poses.json"
FORMAT, VERSION = "koala-truth", 1


def has_truth(recording: Path) -> bool:
    """True for a recording of a simulated rig."""
    return (Path(recording) / TRUTH / POSES).is_file()


def calibration_error(recording: Path, calibration: Calibration) -> dict[str, Any]:
    """Error of a calibration against the true geometry of the simulated rig.

    Returns:
        `hand_eye_mm` and `hand_eye_deg`: error of flange_from_camera. `camera_mm` and `camera_deg`: median error of the camera
        poses that a scene of this recording would have, the arm's own error included.

    Raises:
        UsageError: the recording is of a real rig, or the calibration holds no hand-eye pose.
    """
    if not has_truth(recording):
        raise UsageError("recording has no ground truth", where=recording, remedy="only simulated recordings have it")
    if calibration.flange_from_camera is None:
        raise UsageError("calibration holds no hand-eye pose", remedy="make one with 'calib handeye'")
    source = Path(recording) / TRUTH / POSES
    content = files.read_json(source, kind=FORMAT, version=VERSION)
    found = calibration.flange_from_camera.matrix
    true = pose.checked(content["flange_from_camera"], where=f"{source}, flange_from_camera")
    shift, turn = pose.difference(found, true)
    frames = [frame for frame in Recording.open(recording).frames if frame.name in content["base_from_camera"]]
    if not frames:
        raise UsageError("recording holds no frames", where=recording, remedy="record it first")
    cameras = []
    for frame in frames:
        expected = pose.checked(content["base_from_camera"][frame.name], where=source)
        cameras.append(pose.difference(calibration.camera_pose(frame.base_from_flange, frame.joints), expected))
    camera_shift, camera_turn = np.median(cameras, axis=0)
    errors = {"hand_eye_mm": float(1e3 * shift), "hand_eye_deg": float(np.rad2deg(turn)), "frames": len(frames)}
    return errors | {"camera_mm": float(1e3 * camera_shift), "camera_deg": float(np.rad2deg(camera_turn))}
