"""`calib cameras` on pictures. Both recordings are of one camera: its pose in its own frame is the identity."""

import json
from functools import partial

import numpy as np
import pytest

from koala3d.calib.cli import main
from koala3d.datasets.calibration import Calibration, UncertainPose


@pytest.fixture(scope="module")
def calib(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "calib")


def test_a_calibration_for_each_camera_and_the_pose_between_them(calib, recorded, recorded_again, tmp_path):
    result = calib("cameras", recorded[0], recorded_again[0], "--out", tmp_path / "rig")
    assert result.returncode == 0, result.stderr
    assert "recording" in result.stdout and "again in recording: (" in result.stdout
    assert "0 of 19 stops were seen by more than one camera" in result.stdout
    content = json.loads((tmp_path / "rig" / "cameras.json").read_text())
    between = UncertainPose.from_json(content["first_from_camera"]["again"], where="cameras.json")
    assert np.linalg.norm(between.matrix[:3, 3]) < 4e-3 * between.total_std[0]  # four deviations, given in mm
    for name in ("recording", "again"):
        calibration = Calibration.load(tmp_path / "rig" / f"{name}.json")
        assert calibration.flange_from_camera is not None and calibration.residuals.views_used >= 8


def test_recordings_of_one_name_are_refused(calib, recorded, tmp_path):
    result = calib("cameras", recorded[0], recorded[0], "--out", tmp_path / "rig")
    assert result.returncode == 2 and "two recordings have the same name" in result.stderr
    assert not (tmp_path / "rig").exists()
