"""Scenes of BOP: projections of the format's own description, worlds, masks, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import detect, load_scene
from koala3d.datasets.imaging import images

K = np.array([[120.0, 0, 31.25], [0, 121.0, 23.5], [0, 0, 1]])


def moved_by(k: float) -> np.ndarray:
    """`K` with another principal point, which differs from image to image in T-LESS."""
    return K + np.array([[0, 0, k], [0, 0, -k], [0, 0, 0]])


def written(folder: Path, *, world: bool = True, objects: int = 1, count: int = 6, gray: bool = False) -> list[np.ndarray]:
    """Write a scene; returns (4, 4) camera_from_world (or from the model of object 5) of its images [mm]."""
    poses, cameras, annotations = [], {}, {}
    random = np.random.default_rng(0)
    for k in range(count):
        matrix = pose.inverse(pose.look_at((400 * np.cos(k), 400 * np.sin(k), 300), (0, 0, 0)))
        poses.append(matrix)
        cameras[str(k + 10)] = {"cam_K": moved_by(k).ravel().tolist(), "depth_scale": 0.1}
        if world:
            cameras[str(k + 10)] |= {"cam_R_w2c": matrix[:3, :3].ravel().tolist(), "cam_t_w2c": matrix[:3, 3].tolist()}
        one = {"obj_id": 5, "cam_R_m2c": matrix[:3, :3].ravel().tolist(), "cam_t_m2c": matrix[:3, 3].tolist()}
        other = {"obj_id": 9, "cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0, 0, 500]}
        annotations[str(k + 10)] = [other] * (objects - 1) + [one]
        shape = (48, 64, 1) if gray else (48, 64, 3)
        images.write(folder / ("gray" if gray else "rgb") / f"{k + 10:06d}.png", random.integers(0, 255, shape, np.uint8))
        for number in range(objects):
            mask = np.zeros((48, 64, 1), np.uint8)
            mask[10 + number : 30, 20:40] = 255
            images.write(folder / "mask_visib" / f"{k + 10:06d}_{number:06d}.png", mask)
    files.write_json(folder / "scene_camera.json", cameras)
    files.write_json(folder / "scene_gt.json", annotations)
    return poses


@pytest.mark.parametrize("world", [True, False])
def test_points_are_seen_where_the_format_says(tmp_path, world) -> None:
    poses = written(tmp_path / "000001", world=world)
    scene = load_scene(tmp_path / "000001")
    assert detect(tmp_path / "000001") == "bop" and scene.metric
    assert [view.name for view in scene.views] == [f"{k:06d}" for k in range(10, 16)]
    points = np.random.default_rng(1).uniform(-50, 50, (20, 3))
    for k, (view, matrix) in enumerate(zip(scene.views, poses, strict=True)):
        shown = moved_by(k) @ (points @ matrix[:3, :3].T + matrix[:3, 3]).T
        local = (1e-3 * points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
        assert np.allclose(view.camera.project(local), (shown[:2] / shown[2]).T + 0.5, atol=1e-9)
        assert view.read_mask()[20, 30] == 1 and view.read_mask()[5, 5] == 0


def test_of_several_objects_that_shown_once_is_the_world_with_its_mask(tmp_path) -> None:
    written(tmp_path / "000001", world=False, objects=3)
    scene = load_scene(tmp_path / "000001")
    assert any("the world is the model of object 5" in note for note in scene.notes)
    assert all(view.mask.name.endswith("_000002.png") for view in scene.views)


def test_masks_of_several_objects_are_not_used_in_a_world(tmp_path) -> None:
    written(tmp_path / "000001", objects=2, gray=True)
    scene = load_scene(tmp_path / "000001")
    assert not any(view.mask for view in scene.views) and any("several objects" in note for note in scene.notes)


def test_images_without_the_object_are_counted(tmp_path) -> None:
    written(tmp_path / "000001", world=False)
    annotations = files.read_json(tmp_path / "000001" / "scene_gt.json")
    files.write_json(tmp_path / "000001" / "scene_gt.json", annotations | {"11": []})
    scene = load_scene(tmp_path / "000001")
    assert len(scene.views) == 5 and any("1 of 6 images do not show object 5 once" in note for note in scene.notes)


def test_without_any_pose_it_is_refused(tmp_path) -> None:
    written(tmp_path / "000001", world=False)
    (tmp_path / "000001" / "scene_gt.json").unlink()
    with pytest.raises(DatasetError, match=r"poses of the cameras are not stated \(no cam_R_w2c\)"):
        load_scene(tmp_path / "000001")


def test_damaged_numbers_are_named(tmp_path) -> None:
    written(tmp_path / "000001")
    cameras = files.read_json(tmp_path / "000001" / "scene_camera.json")
    cameras["12"]["cam_K"] = cameras["12"]["cam_K"][:8]
    files.write_json(tmp_path / "000001" / "scene_camera.json", cameras)
    with pytest.raises(DatasetError, match=r"scene_camera.json, 12: cam_K is not 9 numbers"):
        load_scene(tmp_path / "000001")
