"""Koala by NerfBaselines' protocol, without NerfBaselines: its data are plain arrays, whose meaning is written out here."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.benchmark.dataset import MODELS, camera_of, scene_of
from koala3d.reconstruct.benchmark.method import Koala

SETTINGS = {
    "encoding.levels": 1, "encoding.log2_size": 6, "field.spatial_width": 4, "field.view_width": 4, "field.bottleneck": 2,
    "field.ide_degree": 1, "sampler.grid": 16, "sampler.rays": 64, "sampler.steps": 32, "sampler.samples": 512,
    "surface.enabled": False, "train.steps": 5,
}  # fmt: skip
POINT = np.array([0.1, -0.2, 1.5])  # in the camera


@dataclass(frozen=True)
class Cameras:
    """`nerfbaselines.Cameras`: n cameras, or one if the arrays lack their first axis."""

    poses: np.ndarray
    intrinsics: np.ndarray
    camera_models: np.ndarray
    distortion_parameters: np.ndarray
    image_sizes: np.ndarray

    def __iter__(self) -> Iterator["Cameras"]:
        return (Cameras(*(getattr(self, name)[one] for name in self.__annotations__)) for one in range(len(self.poses)))


def one(model: str, distortion: list[float]) -> Cameras:
    intrinsics, size = np.array([80.0, 81, 40.5, 30.25], np.float32), np.array([80, 60], np.int32)
    return Cameras(np.eye(4)[:3], intrinsics, np.int32(MODELS.index(model)), np.array(distortion, np.float32), size)


def test_each_lens_sees_a_point_where_opencv_does() -> None:
    matrix = np.array([[80, 0, 40.0], [0, 81, 29.75], [0, 0, 1]])  # OpenCV's first pixel is at (0, 0)
    k1, k2, p1, p2, k3, k4, k5, k6 = 0.1, -0.03, 0.004, -0.002, 0.02, 0.05, -0.01, 0.003
    everything = [k1, k2, p1, p2, k3, k4, k5, k6]
    lenses = {"pinhole": [0.0] * 4, "opencv": [k1, k2, p1, p2], "full_opencv": everything}
    still, bent = np.zeros(3), np.array([k1, k2, k3, k4])
    expected = {name: cv2.projectPoints(POINT, still, still, matrix, np.array(lens))[0] for name, lens in lenses.items()}
    expected["opencv_fisheye"] = cv2.fisheye.projectPoints(POINT[None, None], still, still, matrix, bent)[0]
    assert set(expected) == set(MODELS)
    for model, pixel in expected.items():
        camera, world_from_camera = camera_of(one(model, everything))
        assert np.allclose(camera.project(POINT) - 0.5, pixel, atol=1e-4), model  # the arrays are float32
        assert np.array_equal(world_from_camera, np.eye(4))


@pytest.fixture
def dataset(ball_scene: tuple[Scene, Path]) -> dict:
    """The ball as NerfBaselines loads it: RGBA in bytes."""
    views = ball_scene[0].split("train")
    cameras = Cameras(
        np.stack([view.world_from_camera[:3] for view in views]).astype(np.float32),
        np.array([[v.camera.fx, v.camera.fy, v.camera.cx, v.camera.cy] for v in views], np.float32),
        np.zeros(len(views), np.int32),
        np.zeros((len(views), 0), np.float32),
        np.array([[v.camera.width, v.camera.height] for v in views], np.int32),
    )
    return {"cameras": cameras, "images": [np.uint8(np.rint(255 * view.read())) for view in views], "masks": None, "metadata": {}}


def test_a_dataset_is_the_same_scene(dataset: dict, ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, original = scene_of(dataset, tmp_path), ball_scene[0].split("train")
    assert scene.background == "white" and {view.split for view in scene.views} == {"train"}
    for view, other in zip(scene.views, original, strict=True):
        assert np.allclose(view.world_from_camera, other.world_from_camera, atol=1e-6) and view.camera == other.camera
        assert np.abs(view.read() - other.read()).max() <= 0.5 / 255 + 1e-6
    assert (scene.box[0] > [0.25, -0.15, 0.0]).all() and (scene.box[1] < [0.55, 0.15, 0.3]).all(), "about the ball"


def test_masks_take_no_part(dataset: dict, tmp_path: Path) -> None:
    dataset["images"] = [picture[..., :3] for picture in dataset["images"]]
    dataset["masks"] = [np.arange(48) > 5 + 0 * np.arange(40)[:, None] for _ in dataset["images"]]
    for view in scene_of(dataset, tmp_path).views:
        assert view.ignored is not None and cv2.imread(str(view.ignored))[3, [2, 10], 0].tolist() == [0, 255]


def test_a_training_is_saved_and_loaded_to_the_bit(dataset: dict, tmp_path: Path) -> None:
    method = Koala(train_dataset=dataset, config_overrides=SETTINGS)
    assert method.get_info()["num_iterations"] == 5 and method.get_info()["loaded_step"] is None
    terms = [method.train_iteration(step) for step in range(3)]
    assert all(np.isfinite(list(one.values())).all() and one["psnr"] > 0 for one in terms)
    camera = next(iter(dataset["cameras"]))
    picture = method.render(camera)
    assert {name: values.shape for name, values in picture.items()} == {
        "color": (40, 48, 3), "depth": (40, 48), "accumulation": (40, 48)
    }  # fmt: skip
    method.save(str(tmp_path / "first"))
    loaded = Koala(checkpoint=str(tmp_path / "first"))
    assert loaded.get_info()["loaded_step"] == 3
    again = loaded.render(camera)
    assert all(np.array_equal(picture[name], again[name]) for name in picture)
    loaded.save(str(tmp_path / "second"))
    files = [
        {p.relative_to(tmp_path / n): p.read_bytes() for p in (tmp_path / n).rglob("*") if p.is_file()}
        for n in ("first", "second")
    ]
    assert files[0] == files[1] and files[0]
    with pytest.raises(RuntimeError, match="not trained on"):
        loaded.train_iteration(3)


def test_what_is_not_given_is_said() -> None:
    with pytest.raises(ValueError, match="neither a checkpoint nor a dataset"):
        Koala()
