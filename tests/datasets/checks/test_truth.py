import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks import truth
from koala3d.datasets.core.errors import DatasetError, UsageError

CAMERA = Camera(48, 40, 70.0, 70.0, 24.0, 20.0)
FOUND = UncertainPose(np.eye(4), np.eye(6))


def test_errors_match_the_simulated_ones(simulated_session: Callable[..., Path], tmp_path: Path) -> None:
    """The true mount is 0.3 mm and 0.2 degrees from the one found; the arm says another 0.4 mm, at right angles."""
    recording = simulated_session(tmp_path / "rec", hand_eye_shift_mm=0.3, hand_eye_turn_deg=0.2, arm_shift_mm=0.4)
    found = truth.calibration_error(recording, Calibration(CAMERA, {}, FOUND))
    assert found["hand_eye_mm"] == pytest.approx(0.3) and found["hand_eye_deg"] == pytest.approx(0.2)
    assert found["camera_mm"] == pytest.approx(0.5) and found["camera_deg"] == pytest.approx(0.2) and found["frames"] == 3


def test_recordings_without_truth_are_refused(simulated_session: Callable[..., Path], tmp_path: Path) -> None:
    recording = simulated_session(tmp_path / "rec")
    with pytest.raises(UsageError, match="no hand-eye pose"):
        truth.calibration_error(recording, Calibration(CAMERA, {}))
    (recording / "truth" / "poses.json").unlink()
    assert not truth.has_truth(recording)
    with pytest.raises(UsageError, match="has no ground truth"):
        truth.calibration_error(recording, Calibration(CAMERA, {}, FOUND))


def test_damaged_truth_is_named(simulated_session: Callable[..., Path], tmp_path: Path) -> None:
    recording = simulated_session(tmp_path / "rec")
    content = json.loads((recording / "truth" / "poses.json").read_text())
    content["flange_from_camera"] = (2 * pose.rigid(np.eye(3), [0, 0, 0])).tolist()
    (recording / "truth" / "poses.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="flange_from_camera"):
        truth.calibration_error(recording, Calibration(CAMERA, {}, FOUND))
