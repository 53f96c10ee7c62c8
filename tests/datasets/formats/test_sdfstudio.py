"""SDFStudio's meta_data.json: OpenCV axes, a matrix of intrinsics for each image."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import detect, load_scene
from tests.foreign import photographs

INTRINSICS = [[50.0, 1e-4, 20.5, 0.0], [0.0, 51.0, 14.5, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
BOX = {"aabb": [[-1, -1, -1], [1, 1, 1]], "near": 0.5, "far": 4.5, "radius": 1.0, "collider_type": "near_far"}


@pytest.fixture
def folder(tmp_path: Path) -> Callable[..., Path]:
    """Writes ten frames; keyword arguments enter the file, `frame` each frame."""

    def write(*, frame: dict[str, Any] | None = None, mask: bool = False, **content: Any) -> Path:
        frames = []
        for index in range(10):
            picture = np.random.default_rng(index).integers(0, 256, (30, 40, 3), np.uint8)
            photographs.write(tmp_path / f"{index:06d}_rgb.png", picture)
            matrix = pose.look_at((2 * np.cos(index), 2 * np.sin(index), 0.5), (0, 0, 0))
            made = {"rgb_path": f"{index:06d}_rgb.png", "camtoworld": matrix.tolist(), "intrinsics": INTRINSICS, **(frame or {})}
            if mask:
                made["foreground_mask"] = f"{index:06d}_foreground_mask.png"
                disc = np.hypot(*(np.mgrid[:30, :40] - np.array([14.5, 20.0])[:, None, None])) < 8
                photographs.write(tmp_path / made["foreground_mask"], np.uint8(255 * disc))
            frames.append(made)
        known = {"camera_model": "OPENCV", "height": 30, "width": 40, "has_mono_prior": True, "scene_box": BOX, "frames": frames}
        (tmp_path / "meta_data.json").write_text(json.dumps({**known, **content}))
        return tmp_path

    return write


def test_poses_cameras_and_bounds_are_the_files(folder: Callable[..., Path]) -> None:
    assert detect(folder()) == "sdfstudio"
    scene = load_scene(folder())
    assert [view.split for view in scene.views] == ["test", *["train"] * 7, "test", "train"]
    for index, view in enumerate(scene.views):
        assert np.abs(view.world_from_camera - pose.look_at((2 * np.cos(index), 2 * np.sin(index), 0.5), (0, 0, 0))).max() < 1e-12
        assert view.camera == Camera(40, 30, 50.0, 51.0, 20.5, 14.5) and view.read().shape == (30, 40, 3)
    assert scene.box.tolist() == BOX["aabb"] and (scene.near, scene.far) == (0.5, 4.5) and scene.box_is_stated


def test_masks_narrow_the_box(folder: Callable[..., Path]) -> None:
    scene = load_scene(folder(mask=True))
    assert scene.background == "white" and scene.views[0].read().shape[-1] == 4
    assert (np.abs(scene.box) < 0.9).all() and "masks" in scene.bounds_from


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"camera_model": "FISHEYE"}, "camera model FISHEYE is not supported|pose"),
        ({"frame": {"intrinsics": None}}, "intrinsics: does not hold 3 x 3 numbers"),
        ({"frame": {"camtoworld": None}}, "pose is not"),
        ({"frame": {"rgb_path": "../a.png"}}, "listed twice|leaves the folder"),
        ({"frames": [{"camtoworld": []}]}, "no list of frames"),
        ({"frames": 7}, "is no sdfstudio scene|no list of frames|no images"),
        ({"scene_box": {"aabb": [[1, 1, 1], [0, 0, 0]]}}, "scene_box is empty"),
        ({"scene_box": {**BOX, "near": 9}}, "near and far are not in order"),
    ],
)
def test_what_cannot_be_read_is_named(folder: Callable[..., Path], content: dict[str, Any], words: str) -> None:
    with pytest.raises(DatasetError, match=words) as refused:
        load_scene(folder(**content))
    assert "\n" not in str(refused.value)
