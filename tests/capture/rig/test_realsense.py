"""A Franka with a RealSense: planned, simulated, recorded with its depth, and built into a scene."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.doctor.examine import examine
from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording.check import check
from koala3d.capture.recording.recorder import _size, record
from koala3d.capture.rig.naming import describe
from koala3d.capture.rig.opening import open_rig
from koala3d.datasets.building.build import build
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording

pytest.importorskip("pyrealsense2", exc_type=ImportError)  # or its libusb is absent

SMALL = ["camera.width=320", "camera.height=180", "views.0.count=2", "split.train=1", "split.test=1"]
SMALL += ["views.0.rings=1", "views.0.elevation_deg=[45, 45]"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session with the board's table, whose picture and depth need no renderer."""
    session = load_trajectory("koala_realsense", overrides=SMALL)
    out = tmp_path_factory.mktemp("franka") / "rec"
    board = load_trajectory("calibration_demo")
    lit = session.model_copy(update={"target": board.target, "board": board.board})
    with open_rig("sim:franka_realsense", lit, scene="board", seed=2, time_scale=50.0) as rig:
        assert _size(session, ["train"], rig) > _size(session, ["train"], without_depth(rig))
        record(session, rig, out)
    return out


def without_depth(rig):
    camera = rig.description.camera.model_copy(update={"depth": None})
    return replace(rig, description=rig.description.model_copy(update={"camera": camera}))


def test_the_shipped_trajectory_can_be_taken():
    carrier = describe("franka_realsense").carrier()
    assert len(plan(load_trajectory("koala_realsense", overrides=["views.0.count=4", "split=null"]), carrier)) == 4


def test_the_doctor_finds_nothing_wrong(tmp_path):
    lines = examine(describe("franka_realsense"), "", tmp_path, simulated=True, seconds=0.1)
    assert {line.name for line in lines if line.verdict is Verdict.WRONG} == set()
    found = {line.name: line.found for line in lines}
    assert found["camera link"] == "USB 3.2" and "gain 16" in found["camera settings"]


def test_depth_lies_beside_each_picture_and_agrees_with_the_table(recorded):
    recording = Recording.open(recorded)
    said, truth = recording.part("camera")["depth"], files.read_json(recorded / "truth" / "poses.json")
    seen = Camera.from_json(said["camera"], where="depth")
    assert not [finding for finding in check(recorded) if "depth" in finding.what]
    for frame in recording.frames:
        assert frame.depth is not None and frame.depth.file == f"depth/{frame.name}.png"
        steps = images.read_stored(recorded / frame.depth.file)[..., 0]
        assert steps.dtype == np.uint16 and steps.shape == (seen.height, seen.width)
        base_from_depth = np.array(truth["base_from_camera"][frame.name]) @ np.array(said["camera_from_depth"])
        points = seen.directions(seen.pixel_centres()) * (steps * said["unit_m"])[..., None]
        heights = (points[steps > 0] @ base_from_depth[:3, :3].T + base_from_depth[:3, 3])[:, 2]
        assert (steps > 0).mean() > 0.9 and abs(np.median(heights)) < 5e-4, "the table is at zero"


def test_the_scene_carries_depth_and_says_that_nothing_uses_it(recorded, tmp_path):
    truth = files.read_json(recorded / "truth" / "poses.json")
    known = UncertainPose(np.array(truth["flange_from_camera"]), 1e-8 * np.eye(6))
    Calibration(Camera.from_json(truth["camera"], where="truth"), {}, known, known).save(tmp_path / "cal.json")
    build(recorded, tmp_path / "cal.json", tmp_path / "scene")
    scene = load_scene(tmp_path / "scene")
    names = {view.name for view in scene.views}
    assert names and {path.stem for path in (tmp_path / "scene" / "sensor" / "depth").iterdir()} == names
    assert (tmp_path / "scene" / "sensor" / "manifest.json").is_file()
    assert any("it is no truth, and nothing uses it" in note for note in scene.notes)
    assert all("depth" not in view.truth for view in scene.views if view.split == "train")


def test_depth_that_was_changed_or_lost_is_named(recorded, tmp_path):
    damaged = tmp_path / "rec"
    shutil.copytree(recorded, damaged)
    first, second = Recording.open(damaged).frames
    (damaged / first.depth.file).write_bytes(b"x")
    (damaged / second.depth.file).unlink()
    what = {(finding.what, finding.frame) for finding in check(damaged)}
    assert {("its depth has changed", first.name), ("its depth is missing", second.name)} <= what
    truth = files.read_json(recorded / "truth" / "poses.json")
    known = UncertainPose(np.array(truth["flange_from_camera"]), 1e-8 * np.eye(6))
    Calibration(Camera.from_json(truth["camera"], where="truth"), {}, known, known).save(tmp_path / "cal.json")
    with pytest.raises(DatasetError, match=r"depth is not what was recorded .its SHA-256 differs"):
        build(damaged, tmp_path / "cal.json", tmp_path / "scene")
    assert Recording.open(damaged).discard([first.name]) == [first.name] and not (damaged / first.depth.file).exists()
