import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from koala3d.datasets import pose
from koala3d.datasets.building.build import build, with_measured_near
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import load_scene, save_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.region import Region
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.matching import BLUR_PX
from koala3d.datasets.structure.reprojection import errors_px

CAMERA = Camera(48, 36, 45.0, 45.5, 24.6, 17.1, k1=-0.1, k2=0.02, p1=1e-3, p2=-5e-4)
FLANGE_FROM_CAMERA = pose.from_rotation_vector((0.7, 0.02, -0.01), (0.001, 0.06, 0.08))
OBJECT = {"centre": [0.4, 0.0, 0.15], "size": [0.2, 0.2, 0.3]}


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    known = UncertainPose(FLANGE_FROM_CAMERA, 1e-8 * np.eye(6))
    Calibration(CAMERA, {"fx": 0.1}, known, known, region=Region(48, 36)).save(tmp_path / "cal.json")
    return tmp_path / "cal.json"


@pytest.fixture
def recording(tmp_path: Path, far_wall: Callable) -> Recording:
    """Five frames about an object at (0.4, 0, 0.15), two of them for testing and with truth."""
    manifest = {"trajectory": {"object": OBJECT}, "camera": {"region": Region(48, 36).to_json()}}
    recording = Recording.create(tmp_path / "rec", manifest)
    for index in range(5):
        angle, name = 2 * np.pi * index / 5, f"{index:03d}"
        base_from_camera = pose.look_at((0.4 + 0.4 * np.cos(angle), 0.4 * np.sin(angle), 0.4), (0.4, 0, 0.15))
        path = recording.path / "images" / f"{name}.png"
        images.write(path, far_wall(CAMERA, base_from_camera))
        if index in (0, 3):
            images.write(recording.path / "truth" / "depth" / f"{name}.exr", np.full((36, 48, 1), 0.4, np.float32))
            images.write(recording.path / "truth" / "alpha" / f"{name}.png", np.ones((36, 48, 1)))
        flange = base_from_camera @ pose.inverse(FLANGE_FROM_CAMERA)
        split = "test" if index in (0, 3) else "train"
        recording.append(
            Frame(
                index=index,
                name=name,
                split=split,
                image=f"images/{name}.png",
                base_from_flange=flange,
                joints=np.zeros(6),
                robot_time_s=1.0,
                host_time_ns=1,
                device_ticks=1,
                exposure_us=1e4,
                settle_s=0.3,
                sha256=files.sha256(path),
            )
        )
    files.write_text(recording.path / "truth" / "object.ply", "ply\n")
    files.write_json(recording.path / "truth" / "poses.json", {"secret": True})
    return recording


@pytest.mark.parametrize(("train", "noted"), [(3, False), (8, True)])
def test_a_scene_of_an_incomplete_recording_says_so(
    recording: Recording, calibration: Path, tmp_path: Path, train: int, noted: bool
) -> None:
    path = recording.path / "manifest.json"
    content = files.read_json(path)
    files.write_json(path, content | {"trajectory": {"object": OBJECT, "split": {"train": train, "test": 2}}})
    notes = build(recording.path, calibration, tmp_path / "scene").notes
    assert any("incomplete, 5 of 10 views" in note for note in notes) == noted


def test_a_scene_is_built_in_the_robots_base(recording: Recording, calibration: Path, tmp_path: Path) -> None:
    build(recording.path, calibration, tmp_path / "koala" / "thing")
    scene = load_scene("koala/thing", data_root=tmp_path)
    assert scene.name == "thing" and scene.metric and scene.background == "scene" and scene.far == np.inf
    assert [view.split for view in scene.views] == ["test", "train", "train", "test", "train"]
    assert np.allclose(scene.box, [[0.3, -0.1, 0.0], [0.5, 0.1, 0.3]])
    for view, frame in zip(scene.views, recording.frames, strict=True):
        assert view.camera == CAMERA
        assert np.abs(view.world_from_camera - frame.base_from_flange @ FLANGE_FROM_CAMERA).max() < 1e-12
        centre = pose.inverse(view.world_from_camera) @ [0.4, 0, 0.15, 1]
        assert np.abs(centre[:2]).max() < 1e-9 and centre[2] == pytest.approx(0.4717, abs=1e-3)  # sqrt(0.4^2 + 0.25^2)
        assert files.sha256(view.image) == frame.sha256 == scene.provenance["frames_sha256"][frame.name]
        assert sorted(view.truth) == (["alpha", "depth"] if view.split == "test" else [])
    assert 0 < scene.near < 0.2  # nearer than the box's nearest corner, so that the table stays in sight
    assert (tmp_path / "koala" / "thing" / "truth" / "object.ply").is_file()
    assert not list((tmp_path / "koala" / "thing").rglob("poses.json"))  # true poses stay with the recording


def test_smaller_images_and_the_evidence_of_bounds(recording: Recording, calibration: Path, tmp_path: Path) -> None:
    build(recording.path, calibration, tmp_path / "scene", sizes=(2, 3))
    assert load_scene(tmp_path / "scene").bounds_from == "stated"
    small = load_scene(tmp_path / "scene", images="images_3").views[1]
    assert small.camera == CAMERA.scaled(16, 12) and small.read().shape == (12, 16, 3)
    manifest = files.read_json(recording.path / "manifest.json")
    files.write_json(recording.path / "manifest.json", {**manifest, "trajectory": {}})
    assert build(recording.path, calibration, tmp_path / "unstated").bounds_from == "cameras alone"


def test_another_region_of_the_same_sensor_is_converted_exactly(recording: Recording, calibration: Path, tmp_path: Path) -> None:
    """Calibrated with the whole sensor of 240x180, recorded with a region of 96x72 at (40, 30), binned by two."""
    theirs, ours = Region(240, 180), Region(48, 36, 20, 15, 2)
    whole = replace(CAMERA, width=240, height=180, fx=90.0, fy=91.0, cx=2 * 20 + 49.2, cy=2 * 15 + 34.2)
    known = Calibration.load(calibration)
    replace(known, camera=whole, region=theirs).save(tmp_path / "whole.json")
    files.write_json(recording.path / "manifest.json", {**recording.manifest, "camera": {"region": ours.to_json()}})
    scene = build(recording.path, tmp_path / "whole.json", tmp_path / "scene")
    camera = scene.views[0].camera
    assert (camera.width, camera.height) == (48, 36) and "converted" in scene.notes[0]
    assert np.allclose([camera.fx, camera.fy, camera.cx, camera.cy], [45.0, 45.5, 24.6, 17.1])


def unhinge(recording: Recording, calibration: Path, how: str) -> None:
    """Damage a recording or calibration in one way."""
    first = recording.path / "images" / "002.png"
    if how == "size":
        images.write(first, np.zeros((36, 47, 3)))
    elif how == "gone":
        first.unlink()
    elif how == "altered":
        images.write(first, np.zeros((36, 48, 3)))
    elif how == "other camera":
        known = Calibration.load(calibration)
        replace(known, camera=CAMERA.scaled(96, 72), region=None).save(calibration)
    elif how == "no hand-eye":
        replace(Calibration.load(calibration), flange_from_camera=None).save(calibration)
    elif how == "NaN":
        content = files.read_json(calibration)
        calibration.write_text(__import__("json").dumps(content | {"camera": content["camera"] | {"fx": float("nan")}}))
    elif how == "object":
        trajectory = {"object": {"centre": [0, 0, 0], "size": [0.1, -1, 0.1]}}
        files.write_json(recording.path / "manifest.json", {**recording.manifest, "trajectory": trajectory})
    elif how == "board":
        path = recording.path / "frames.jsonl"
        path.write_text(path.read_text().replace('"train"', '"calibration"').replace('"test"', '"calibration"'))
    elif how == "empty":
        os.truncate(recording.path / "frames.jsonl", 0)


@pytest.mark.parametrize(
    ("how", "kind", "words"),
    [
        ("size", DatasetError, "002.png: image has the wrong size"),
        ("gone", UsageError, "002.png: no such image"),
        ("altered", DatasetError, "002.png: image is not the one that was recorded"),
        ("other camera", DatasetError, "images are 48x36, the calibrated camera is 96x72"),
        ("no hand-eye", UsageError, "run 'calib handeye'"),
        ("NaN", DatasetError, "not finite"),
        ("object", DatasetError, "object's volume is impossible"),
        ("board", UsageError, "all 5 frames are of a calibration session"),
        ("empty", UsageError, "holds no frames"),
    ],
)
def test_damage_is_reported_and_leaves_nothing(
    recording: Recording, calibration: Path, tmp_path: Path, how: str, kind: type, words: str
) -> None:
    unhinge(recording, calibration, how)
    with pytest.raises(kind, match=words.replace("(", r"\(")):
        build(recording.path, calibration, tmp_path / "here" / "scene")
    assert not (tmp_path / "here").exists() or list((tmp_path / "here").iterdir()) == []


def test_nothing_is_overwritten(recording: Recording, calibration: Path, tmp_path: Path) -> None:
    build(recording.path, calibration, tmp_path / "scene")
    with pytest.raises(UsageError, match="already exists"):
        build(recording.path, calibration, tmp_path / "scene")


def test_near_is_measured_in_the_images(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    found = with_measured_near(scene)
    assert np.array_equal(found.box, scene.box) and found.far == scene.far
    assert 0.8 * 3.3 < found.near < 4.0 and scene.near < found.near  # the square stands 4 away, its corners nearer
    assert "triangulated from 12 views" in found.bounds_from


def test_triangulated_points_stay_in_the_scene_and_its_exports(two_walls: Callable[..., Scene], tmp_path: Path) -> None:
    """With what views saw of them: other programs start from these points."""
    scene = with_measured_near(two_walls())
    points, colours = scene.points, scene.colours
    assert points is not None and colours is not None and len(colours) == len(points) > 200
    assert np.median(errors_px(scene)) < 0.5  # px of pictures that were searched at full size
    first = scene.sightings.index[:, 1] == 0
    column, row = scene.sightings.pixels[first].astype(int).T
    light = images.linear_from_srgb(images.read(scene.views[0].image)[..., 0])
    blurred = 255 * images.srgb_from_linear(gaussian_filter(light, BLUR_PX)[row, column])
    told = colours[scene.sightings.index[first, 0], 0]
    assert np.median(np.abs(blurred - told)) < 5  # the points' colours are means over their views
    for layout in ("koala", "nerfstudio", "colmap"):
        if layout == "colmap":
            pytest.importorskip("pycolmap")
        save_scene(scene, tmp_path / layout, layout)
        again = load_scene(tmp_path / layout)
        assert again.points is not None and again.colours is not None
        order, back = (np.lexsort(np.round(cloud, 9).T) for cloud in (points, again.points))
        np.testing.assert_allclose(again.points[back], points[order], atol=1e-8)
        assert np.array_equal(again.colours[back], colours[order])


def test_near_stays_where_nothing_can_be_triangulated(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    for view in scene.views:
        images.write(view.image, np.full((150, 200, 3), 0.5))
    found = with_measured_near(scene)
    assert (found.near, found.far, found.bounds_from) == (scene.near, scene.far, scene.bounds_from)
    assert np.array_equal(found.box, scene.box) and found.points is None
    assert "near is a guess: only 0 points triangulated from 12 views, too few" in found.notes[-1]
