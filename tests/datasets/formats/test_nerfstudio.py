"""What nerfstudio's and instant-ngp's readers demand of a transforms.json, held against what is written."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_OPENGL
from koala3d.datasets.formats import load_scene, nerfstudio
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene


@pytest.mark.parametrize("mask", [False, True])
def test_their_rules_hold(make_scene: Callable[..., Scene], tmp_path: Path, mask: bool) -> None:
    scene = make_scene(Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4), mask=mask)
    scene = replace(scene, points=np.arange(12.0).reshape(4, 3))
    nerfstudio.save(scene, tmp_path / "out")
    content = json.loads((tmp_path / "out" / "transforms.json").read_text())
    frames = content["frames"]
    assert [frame["file_path"] for frame in frames] == sorted(frame["file_path"] for frame in frames)
    assert all((tmp_path / "out" / frame["file_path"]).is_file() for frame in frames)
    for key in ("mask_path", "depth_file_path"):
        assert len({key in frame for frame in frames}) == 1  # all or none
    assert ("mask_path" in frames[0]) == mask
    listed = {f"{split}_filenames": content[f"{split}_filenames"] for split in ("train", "val", "test")}
    held_out = listed.pop("val_filenames")
    assert held_out == listed["test_filenames"]  # none of the three may be empty
    assert sorted(name for names in listed.values() for name in names) == [frame["file_path"] for frame in frames]
    assert content["camera_model"] == "OPENCV" and content["aabb_scale"] in [2**n for n in range(8)]
    assert content["applied_transform"] == [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]
    first = scene.views[0].world_from_camera @ OPENCV_FROM_OPENGL
    assert np.abs(np.array(frames[0]["transform_matrix"]) - first).max() < 1e-12
    again = load_scene(tmp_path / "out")
    assert again.points is not None and np.array_equal(again.points, scene.points)
    assert np.array_equal(trimesh.load(tmp_path / "out" / content["ply_file_path"]).vertices, scene.points)


def test_depth_is_exported_where_all_views_have_it(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene()
    with_depth = scene.with_views(tuple(view for view in scene.views if view.truth))
    nerfstudio.save(with_depth, tmp_path / "out")
    frame = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"][0]
    assert np.array_equal(np.unique(images.read_stored(tmp_path / "out" / frame["depth_file_path"])), [400])  # 0.4 in thousandths
    assert load_scene(tmp_path / "out").views[0].read_truth("depth")[0, 0, 0] == pytest.approx(0.4, abs=1e-6)
    (tmp_path / "out" / "koala.json").unlink()
    assert not load_scene(tmp_path / "out").views[0].truth  # nobody says that it is the truth


def test_smaller_depth_and_masks_are_there_and_not_mixed(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    """nerfstudio takes them from folders beside `images_N`; half a pixel of surroundings is not the object."""
    scene = make_scene(Camera(98, 75, 90.0, 90.0, 49.0, 37.0), count=5, mask=True)
    depth = tmp_path / "depth.exr"
    values = np.where(np.arange(98)[None, :, None] < 50, 0.4, 0.8) * np.ones((75, 1, 1))
    images.write(depth, values.astype(np.float32))
    scene = scene.with_views(tuple(replace(view, truth={"depth": depth}) for view in scene.views))
    nerfstudio.save(scene, tmp_path / "out", sizes=(4,))
    for view in scene.views:
        small, mask = (images.read_stored(tmp_path / "out" / f"{home}_4" / f"{name}.png") for home, name in
                       (("depths", view.name), ("masks", view.name)))  # fmt: skip
        assert small.shape[:2] == mask.shape[:2] == (18, 24)
        assert set(np.unique(small)) == {400, 800} and set(np.unique(mask)) == {0, 255}


def test_scenes_without_held_out_views_state_no_splits(make_scene: Callable[..., Scene], tmp_path: Path) -> None:
    scene = make_scene(count=5)
    nerfstudio.save(scene.with_views(tuple(replace(view, split="train") for view in scene.views)), tmp_path / "out")
    assert not [key for key in json.loads((tmp_path / "out" / "transforms.json").read_text()) if key.endswith("_filenames")]
    assert load_scene(tmp_path / "out").counts()["train"] == 5  # as the sidecar says
