"""Comparison with the ground truth of a simulation. Only evaluation reads RECORDING/truth."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import ply
from koala3d.datasets.recording import TRUTH, Recording
from koala3d.datasets.scene import TURNED, Scene
from koala3d.datasets.turned.registration import Registration

POSES, SURFACE = "poses.json", "object.ply"
FORMAT, VERSION = "koala-truth", 1


def has_truth(recording: Path) -> bool:
    """True for a recording of a simulated rig."""
    return (Path(recording) / TRUTH / POSES).is_file()


def calibration_error(recording: Path, calibration: Calibration) -> dict[str, Any]:
    """Error of a calibration against the true geometry of the simulated rig.

    Returns:
        `hand_eye_mm` and `hand_eye_deg`: error of flange_from_camera, or of base_from_camera where the camera stands beside the
        arm. `camera_mm` and `camera_deg`: median error of the camera poses that a scene of this recording would have, the arm's
        own error included. Beside the arm `board_mm` and `board_deg`: error of flange_from_board. `frames`: their number.

    Raises:
        UsageError: the recording is of a real rig, or the calibration holds no hand-eye pose.
    """
    if not has_truth(recording):
        raise UsageError("recording has no ground truth", where=recording, remedy="only simulated recordings have it")
    source = Path(recording) / TRUTH / POSES
    content = files.read_json(source, kind=FORMAT, version=VERSION)
    beside = content.get("flange_from_board") is not None
    found = calibration.base_from_camera if beside else calibration.flange_from_camera
    if found is None:
        raise UsageError("calibration holds no hand-eye pose", remedy="make one with 'calib handeye'")
    frames = [frame for frame in Recording.open(recording).frames if frame.name in content["base_from_camera"]]
    if not frames:
        raise UsageError("recording holds no frames", where=recording, remedy="record it first")
    true = {name: pose.checked(matrix, where=source) for name, matrix in content["base_from_camera"].items()}
    if beside:
        mount, stand = true[frames[0].name], pose.checked(content["flange_from_board"], where=f"{source}, flange_from_board")
        others = {} if calibration.flange_from_board is None else _error("board", calibration.flange_from_board.matrix, stand)
    else:
        mount = pose.checked(content["flange_from_camera"], where=f"{source}, flange_from_camera")
        poses = np.stack([calibration.camera_pose(frame.base_from_flange, frame.joints) for frame in frames])
        others = _error("camera", poses, np.stack([true[frame.name] for frame in frames]))
    return {**_error("hand_eye", found.matrix, mount), "frames": len(frames), **others}


def turned_error(scene: Scene) -> dict[str, float]:
    """Error of the motion that a scene states of an object that was turned over, against the simulation's.

    Returns:
        `shift_mm` and `turn_deg`: how far the object's middle is off, and the angle. `shift_deviation_mm` and
        `turn_deviation_deg`: their standard deviations over all axes, as stated. `in_deviations`: the root of the mean of the
        error's six numbers squared in units of the stated covariance, 1 where it holds.

    Raises:
        UsageError: the scene is not one of two sessions, or a recording of it is missing or of a real rig.
    """
    sessions = [session.get("recording") for session in scene.provenance.get("merged", ())]
    if TURNED not in scene.provenance or len(sessions) != 2:
        raise UsageError("scene is not of two sessions of an object that was turned over", where=scene.name)
    surfaces = [Path(session or "") / TRUTH / SURFACE for session in sessions]
    if absent := [path for path in surfaces if not path.is_file()]:
        raise UsageError("recording has no ground truth", where=absent[0], remedy="only simulated recordings have it")
    found, (in_a, in_b) = Registration.from_json(scene.provenance[TURNED]), (ply.read_points(path) for path in surfaces)
    if len(in_a) != len(in_b):
        raise UsageError("recordings are of different objects", where=", ".join(map(str, surfaces)))
    rotation = Rotation.align_vectors(in_a - in_a.mean(0), in_b - in_b.mean(0))[0].as_matrix()
    by = found.error(pose.rigid(rotation, in_a.mean(0) - rotation @ in_b.mean(0)))
    shift, turn = found.deviations
    return {
        "shift_mm": float(1e3 * np.linalg.norm(by[:3])),
        "turn_deg": float(np.rad2deg(np.linalg.norm(by[3:]))),
        "shift_deviation_mm": 1e3 * shift,
        "turn_deviation_deg": float(np.rad2deg(turn)),
        "in_deviations": float(np.sqrt(by @ np.linalg.solve(found.covariance, by) / 6)),
    }


def _error(what: str, found: NDArray[np.float64], true: NDArray[np.float64]) -> dict[str, float]:
    """Median distance [mm] and angle [deg] of (..., 4, 4) poses from the true ones, under two names."""
    shift, turn = np.median(pose.difference(found, true), axis=-1) if found.ndim > 2 else pose.difference(found, true)
    return {f"{what}_mm": float(1e3 * shift), f"{what}_deg": float(np.rad2deg(turn))}
