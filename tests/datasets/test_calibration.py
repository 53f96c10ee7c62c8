import json
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import kinematics, pose
from koala3d.datasets.calibration import Calibration, LinkErrors, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.residuals import Residuals

CAMERA = Camera(640, 480, 500.0, 501.0, 322.0, 239.0, k1=-0.1)
POSE = UncertainPose(
    pose.from_rotation_vector((0.1, -0.2, 0.3), (0.01, 0.06, 0.08)), np.diag([1e-8, 4e-8, 9e-8, 1e-6, 4e-6, 9e-6])
)


def test_everything_comes_back(tmp_path: Path) -> None:
    more = {"region": Region(640, 480, 8, 4, 2), "residuals": Residuals(rms_px=0.1), "provenance": {"method": "made up"}}
    Calibration(CAMERA, {"fx": 0.1}, POSE, **more).save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    assert again.camera == CAMERA and again.camera_std == {"fx": 0.1} and again.base_from_board is None
    assert again.flange_from_camera is not None
    assert np.abs(again.flange_from_camera.matrix - POSE.matrix).max() < 1e-15
    assert np.array_equal(again.flange_from_camera.covariance, POSE.covariance)
    assert (again.residuals, again.provenance) == (Residuals(rms_px=0.1), {"method": "made up"})
    assert again.region == more["region"]


def test_deviations_of_a_pose_at_the_origin_by_hand() -> None:
    """A standard deviation of 1e-4 m is 0.1 mm; of 1e-3 rad about the first axis is 0.0573 degrees."""
    at_origin = UncertainPose(np.eye(4), POSE.covariance)
    assert np.allclose(at_origin.translation_std_mm, [0.1, 0.2, 0.3])
    assert at_origin.rotation_std_deg[0] == pytest.approx(np.rad2deg(1e-3))


def test_a_rotation_moves_a_distant_origin() -> None:
    """Against draws: twists of the stated covariance, applied from the left, spread the position as stated."""
    random = np.random.default_rng(0)
    twists = random.multivariate_normal(np.zeros(6), POSE.covariance, 20_000)
    moved = np.stack([(pose.from_rotation_vector(t[3:], t[:3]) @ POSE.matrix)[:3, 3] for t in twists])
    assert np.allclose(1e3 * moved.std(0), POSE.translation_std_mm, rtol=0.02)  # standard error of 20,000 draws: 0.5%
    assert (POSE.translation_std_mm > 1.1 * np.array([0.1, 0.2, 0.3])).any()  # the premise: the lever counts here


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"camera": None}, "camera is not complete"),
        ({"flange_from_camera": {"translation_m": [0, 0, 0]}}, "c.json, flange_from_camera: pose is not complete"),
        (
            {
                "flange_from_camera": {
                    "translation_m": [0, 0, float("nan")],
                    "quaternion_wxyz": [1, 0, 0, 0],
                    "covariance": np.eye(6).tolist(),
                }
            },
            "pose is not finite",
        ),
        ({"flange_from_camera": {**POSE.to_json(), "covariance": np.full((6, 6), np.inf).tolist()}}, "covariance is impossible"),
        ({"flange_from_camera": {**POSE.to_json(), "covariance": (-np.eye(6)).tolist()}}, "covariance is impossible"),
        ({"provenance": {"notes": [1.0, float("nan")]}}, r"c.json, provenance, notes, 1: number is not finite \(nan\)"),
        ({"camera_std": {"fx": float("inf")}}, "c.json, camera_std, fx: number is not finite"),
        ({"residuals": [1]}, "c.json, residuals: is not made of names and values"),
        ({"residuals": {"rms_px": "small"}}, "c.json, residuals, rms_px: is not of its kind"),
        ({"residuals": {"views_used": True}}, "c.json, residuals, views_used: is not of its kind"),
        ({"residuals": {"boards": {}}}, "c.json, residuals, boards: is not of its kind"),
        ({"residuals": {"rig_correlation": {"names": ["fx"], "matrix": [1]}}}, "rig_correlation: is not of its kind"),
        (
            {"residuals": {"rig_correlation": {"names": ["x", "y"], "matrix": [[1, 0], [1]]}}},
            "rig_correlation: is not of its kind",
        ),
        ({"region": {"width": 640, "height": 0}}, "c.json, region: sensor region is impossible"),
        ({"format": "koala-scene"}, "is not a koala-calibration file"),
        ({"version": 2}, "version 2 cannot be read"),
    ],
)
def test_damage_is_named(tmp_path: Path, change: dict, words: str) -> None:
    Calibration(CAMERA, {}, POSE).save(tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    (tmp_path / "c.json").write_text(json.dumps(content | change))
    with pytest.raises(DatasetError, match=words):
        Calibration.load(tmp_path / "c.json")


def test_a_missing_file_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        Calibration.load(tmp_path / "none.json")


def test_errors_of_the_links_come_back_and_move_the_camera(tmp_path: Path) -> None:
    offsets = np.deg2rad([0, 0.1, -0.05, 0.02, 0.03, 0])
    errors = LinkErrors(np.concatenate([np.zeros(18), offsets]), np.repeat([0.0, 1e-4], [18, 6]))
    joints = np.array([0.3, -1.5, 1.6, -1.4, -1.5, 0.2])
    reported = kinematics.forward(joints)
    Calibration(CAMERA, {}, POSE, link_errors=errors).save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    assert again.link_errors is not None and np.array_equal(again.link_errors.std, errors.std)
    expected = kinematics.forward(joints + offsets) @ POSE.matrix  # a nominal arm: exact
    assert np.abs(again.camera_pose(reported, joints) - expected).max() < 1e-12
    assert np.array_equal(Calibration(CAMERA, {}, POSE).camera_pose(reported, joints), reported @ POSE.matrix)


def test_impossible_errors_of_the_links_are_refused(tmp_path: Path) -> None:
    Calibration(CAMERA, {}, POSE, link_errors=LinkErrors(np.full(24, 2.0), np.zeros(24))).save(tmp_path / "c.json")
    with pytest.raises(DatasetError, match="errors of the links are not credible"):
        Calibration.load(tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    del content["link_errors"]["a_m"]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(DatasetError, match="errors of the links are not complete"):
        Calibration.load(tmp_path / "c.json")


def test_a_camera_beside_the_arm_has_no_pose_on_it() -> None:
    with pytest.raises(DatasetError, match="no hand-eye pose"):
        Calibration(CAMERA, {}, base_from_camera=POSE).camera_pose(np.eye(4), np.zeros(6))
