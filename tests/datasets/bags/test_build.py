"""Scenes of ROS bags: poses at the exposures, and what the check says of wrong ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import cli, pose
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks.matches import check_matches
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.residuals import Residuals
from tests import bags

LENS = Camera(320, 240, 340.0, 340.0, 160.0, 120.0)
MOUNT = pose.from_rotation_vector([0.05, -0.03, 1.55], [0.3, 0.05, 0.4])
LATE_S = 0.080
TURN, SHIFT = np.array([0.02, 0.0, 0.01]), np.array([0.05, 0.0, 0.03])


def taken(seconds: np.ndarray) -> np.ndarray:
    """(n, 4, 4) way of a camera in front of the walls, with turns about all axes."""
    found = []
    for t in np.atleast_1d(seconds):
        x, y = 0.45 * np.sin(0.9 * t), 0.3 * np.sin(1.9 * t + 0.5)
        place = (4 * np.sin(x), 4 * np.sin(y), -4 * np.cos(x) * np.cos(y))
        found.append(pose.look_at(place, (0.2 * np.sin(t), 0, 0), up=(0.3 * np.sin(1.3 * t), -1, 0)))
    return np.stack(found)


@pytest.fixture(scope="module")
def moving(tmp_path_factory, wall_picture) -> Path:
    """Bag of an arm that never halts, with pictures that are 80 ms late."""
    path, times = tmp_path_factory.mktemp("bags") / "moving", np.arange(0.0, 7.5, 0.01)
    with bags.writing(path, "mcap") as bag:
        for t, flange in zip(times, taken(times) @ pose.inverse(MOUNT), strict=True):
            bag.transform("/tf", bags.START_NS + round(1e9 * t), "base_link", "tool0", flange)
        for t in np.arange(0.3, 7.2, 0.3):
            picture = np.rint(255 * wall_picture(LENS, taken(t)[0])).astype(np.uint8)
            bag.picture("/camera/image_raw", bags.START_NS + round(1e9 * (t + LATE_S)), picture[..., ::-1], "bgr8")
    return path


def calibrated(path: Path, mount: np.ndarray = MOUNT, late_s: float | None = LATE_S, flange: str = "tool0") -> Path:
    """A calibration file."""
    residuals = Residuals() if late_s is None else Residuals(latency_s=late_s, latency_std_s=1e-4)
    known = UncertainPose(mount, 1e-10 * np.eye(6))
    provenance = {"bag": {"base": "base_link", "flange": flange}}
    Calibration(LENS, {}, flange_from_camera=known, residuals=residuals, provenance=provenance).save(path)
    return path


def test_poses_are_those_at_the_exposures_and_nothing_is_wrong(moving, tmp_path, run_inside) -> None:
    words = ["datasets", "build", moving, "--calibration", calibrated(tmp_path / "c.json"), "--out", tmp_path / "scene"]
    assert run_inside(cli.main, *words).returncode == 0
    scene = load_scene(tmp_path / "scene")
    assert scene.counts() == {"train": 21, "val": 0, "test": 3}
    truth = taken(np.arange(0.3, 7.2, 0.3))
    shift, turn = pose.difference(np.stack([view.world_from_camera for view in scene.views]), truth)
    assert shift.max() < 2e-4 and turn.max() < 1e-4  # poses come every 10 ms, and between them the way is bent
    assert any("80.00 ± 0.10 ms" in note for note in scene.notes)
    assert check_matches(scene) == []


@pytest.mark.parametrize(
    ("cause", "wrong"),
    {
        "latency": {"late_s": None},
        "hand-eye": {"mount": MOUNT @ pose.from_rotation_vector(TURN, SHIFT)},
    }.items(),
)
def test_what_is_wrong_is_named(moving, tmp_path, cause, wrong) -> None:
    build(recording_of(moving), calibrated(tmp_path / "c.json", **wrong), tmp_path / "scene")
    (found,) = check_matches(load_scene(tmp_path / "scene"))
    assert found.cause == cause
    change, std = found.evidence["change"], found.evidence["std"]
    expected = [LATE_S] if cause == "latency" else [*(-SHIFT), *(-TURN)]
    assert change == pytest.approx(expected, abs=0.002)  # small motions in a row, taken for one
    assert max(std) < 0.001


def test_inverted_poses_of_the_arm_are_named(moving, tmp_path) -> None:
    build(recording_of(moving), calibrated(tmp_path / "c.json"), tmp_path / "scene")
    scene = load_scene(tmp_path / "scene")
    flanges = [view.world_from_camera @ pose.inverse(MOUNT) for view in scene.views]
    views = [replace(v, world_from_camera=pose.inverse(flange) @ MOUNT) for v, flange in zip(scene.views, flanges, strict=True)]
    (found,) = check_matches(scene.with_views(tuple(views)))
    assert found.level == "error" and "flange_from_base taken for base_from_flange" in found.why


@pytest.mark.parametrize("scale", [1e3, 1.5, 1e-3])
def test_a_wrong_scale_of_the_arm_is_named(moving, tmp_path, scale) -> None:
    build(recording_of(moving), calibrated(tmp_path / "c.json"), tmp_path / "scene")
    scene, views = load_scene(tmp_path / "scene"), []
    for view in scene.views:
        flange = view.world_from_camera @ pose.inverse(MOUNT)
        views.append(replace(view, world_from_camera=pose.rigid(flange[:3, :3], scale * flange[:3, 3]) @ MOUNT))
    (found,) = check_matches(scene.with_views(tuple(views)))
    if found.cause == "scale":
        assert found.evidence["scale"] == pytest.approx(1 / scale, rel=0.01)
    else:
        assert found.level == "error" and "the hand-eye pose in millimetres" in found.why and scale == 1e-3


def test_frames_of_another_flange_are_refused(moving, tmp_path) -> None:
    with pytest.raises(DatasetError, match=r"flange is another frame.*tool0 in the bag, flange in the calibration"):
        build(recording_of(moving), calibrated(tmp_path / "c.json", flange="flange"), tmp_path / "scene")
