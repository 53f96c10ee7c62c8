import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks import truth
from koala3d.datasets.cli import main
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import koala, ply
from koala3d.datasets.scene import TURNED, Scene
from koala3d.datasets.turned.registration import Registration

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


def test_the_motion_of_an_object_that_was_turned_over_is_compared(
    simulated_session: Callable[..., Path],
    run_inside: Callable[..., Any],
    make_scene: Callable[..., Scene],
    tmp_path: Path,
) -> None:
    """Found is the true motion, then 0.3 mm along x and 0.1 degrees about z; 0.1 mm and 0.05 degrees are stated per axis."""
    rng = np.random.default_rng(0)
    in_a = rng.normal(size=(30, 3)) * 0.05 + [0.4, 0, 0.1]
    a_from_b = pose.from_rotation_vector([3.0, 0.2, -0.1], [0.1, 0.5, 0.2])
    recordings = [simulated_session(tmp_path / name) for name in "ab"]
    for folder, points in zip(recordings, (in_a, (in_a - a_from_b[:3, 3]) @ a_from_b[:3, :3]), strict=True):
        ply.write_points(folder / "truth" / "object.ply", points)
    middle = in_a.mean(0)
    off = pose.from_rotation_vector([0, 0, np.deg2rad(0.1)])
    off[:3, 3] = middle - off[:3, :3] @ middle + [3e-4, 0, 0]
    covariance = np.diag([1e-8] * 3 + [np.deg2rad(0.05) ** 2] * 3)
    found = Registration(off @ a_from_b, middle, covariance, 0.3)
    scene = make_scene(CAMERA, 4, truth=False)
    known = {TURNED: {**found.to_json(), "views": []}, "merged": [{"recording": str(folder)} for folder in recordings]}
    scene = replace(scene, provenance=known)
    error = truth.turned_error(scene)
    assert error["shift_mm"] == pytest.approx(0.3, abs=1e-3) and error["turn_deg"] == pytest.approx(0.1, abs=1e-4)
    assert error["in_deviations"] == pytest.approx(np.sqrt((9 + 4) / 6), rel=1e-2)
    koala.save(scene, tmp_path / "whole")
    done = run_inside(main, "datasets", "truth", tmp_path / "whole")
    assert done.returncode == 0 and "error of the motion: 0.300 mm, 0.1000 deg; stated: 0.173 mm" in done.stdout, done.stderr
    for folder, message in ((recordings[0], "add --calibration"), (tmp_path / "plain", "not of two sessions")):
        if not folder.exists():
            koala.save(replace(scene, provenance={}), folder)
        done = run_inside(main, "datasets", "truth", folder)
        assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1
    (recordings[1] / "truth" / "object.ply").unlink()
    with pytest.raises(UsageError, match="has no ground truth"):
        truth.turned_error(scene)


def test_damaged_truth_is_named(simulated_session: Callable[..., Path], tmp_path: Path) -> None:
    recording = simulated_session(tmp_path / "rec")
    content = json.loads((recording / "truth" / "poses.json").read_text())
    content["flange_from_camera"] = (2 * pose.rigid(np.eye(3), [0, 0, 0])).tolist()
    (recording / "truth" / "poses.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="flange_from_camera"):
        truth.calibration_error(recording, Calibration(CAMERA, {}, FOUND))
