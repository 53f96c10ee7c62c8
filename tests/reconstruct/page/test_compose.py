"""Pictures for the page of a run."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.reconstruct.page.compose import (
    BEHIND_ALL,
    CHANNELS,
    Viewpoint,
    enlarged,
    hiding_depth,
    nearest_view,
    picture_of,
    warped,
    wiped,
)

LENS = Camera(96, 72, 90.0, 91.0, 50.3, 34.1, k1=-0.12, k2=0.05, p1=1e-3, p2=-8e-4, k3=0.01)


def viewpoint(matrix: np.ndarray, fov_deg: float = 40.0, aspect: float = 1.5) -> Viewpoint:
    return Viewpoint(matrix, float(np.deg2rad(fov_deg)), aspect)


def values(height: int = 4, width: int = 6, opacity: float = 1.0) -> dict[str, np.ndarray]:
    full = lambda value, count: np.full((height, width, count), value, np.float32)  # noqa: E731
    light = {"rgb": full(0.5, 3), "diffuse": full(0.2, 3), "specular": full(0.1, 3)}
    shape = {"depth": full(2.0, 1), "normals": full(-2.0, 3), "normals_pred": full(0.0, 3)}
    return {**light, **shape, "opacity": full(opacity, 1), "roughness": full(0.3 * opacity, 1)}


@pytest.mark.parametrize("rays", [2048, 8192, 131072])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.4])
def test_pictures_have_the_field_of_view_and_about_as_many_pixels_as_asked(rays: int, aspect: float) -> None:
    camera = viewpoint(np.eye(4), 40.0, aspect).camera(rays)
    assert 0.95 * rays < camera.width * camera.height <= 1.05 * rays
    assert camera.width / camera.height == pytest.approx(aspect, rel=0.05)
    assert 2 * np.arctan(0.5 * camera.height / camera.fy) == pytest.approx(np.deg2rad(40.0))


@pytest.mark.parametrize("channel", CHANNELS)
def test_every_channel_is_a_picture_and_they_differ(channel: str) -> None:
    shown = picture_of(channel, values())
    assert shown.shape == (4, 6, 3) and shown.dtype == np.float32 and 0 <= shown.min() and shown.max() <= 1
    expected = {"rgb": 0.5, "normals": 0.5 - 0.5 / np.sqrt(3), "normals (predicted)": 0.5, "opacity": 1.0, "roughness": 0.3}
    if channel in expected:
        assert np.allclose(shown, expected[channel], atol=1e-6)


def test_roughness_is_that_of_the_surface_however_thin() -> None:
    assert np.allclose(picture_of("roughness", values(opacity=0.5)), 0.3, atol=1e-6)
    assert not picture_of("roughness", values(opacity=0.01)).any()


def test_only_what_is_solid_hides_the_cameras() -> None:
    assert (hiding_depth(values()) == 2.0).all()
    assert (hiding_depth(values(opacity=0.2)) == np.float32(BEHIND_ALL)).all()


def test_a_photograph_warped_its_own_place_is_itself(far_wall: Callable[[Camera, np.ndarray], np.ndarray]) -> None:
    """Lens and rotation are exact for distant objects: the wall at infinity looks the same through the viewpoint's pinhole."""
    matrix = pose.look_at((0.4, 0.1, 0.2), (0, 0, 0))
    view = View("v", LENS, matrix, "train", Path())
    turned = matrix @ pose.from_rotation_vector([0.03, -0.05, 0.4])
    watcher = viewpoint(turned, 25.0, 1.3)
    camera = watcher.camera(8192)
    got = warped(watcher, camera, view, far_wall(LENS, matrix).astype(np.float32))
    inside = (np.abs(got - 0.5) > 1e-6).any(-1)
    assert inside.mean() > 0.9
    error = np.abs(got - far_wall(camera, turned))[inside]
    assert np.median(error) < 0.01 and np.percentile(error, 99) < 0.05  # linear between pixels half as fine as the result's


def test_a_photograph_behind_shows_nothing() -> None:
    view = View("v", LENS, np.eye(4), "train", Path())
    watcher = viewpoint(pose.from_rotation_vector([0, np.pi, 0]))
    assert (warped(watcher, watcher.camera(2048), view, np.ones((72, 96, 3), np.float32)) == 0.5).all()


def test_alpha_is_laid_over_white() -> None:
    view, watcher = View("v", LENS, np.eye(4), "train", Path()), viewpoint(np.eye(4), 10.0)
    photograph = np.concatenate([np.zeros((72, 96, 3)), np.full((72, 96, 1), 0.25)], -1).astype(np.float32)
    assert np.allclose(warped(watcher, watcher.camera(2048), view, photograph), 0.75)


def test_the_nearest_view_is_near_in_place_and_direction() -> None:
    views = tuple(View(str(i), LENS, pose.look_at((np.cos(a), np.sin(a), 0.3), (0, 0, 0)), "train", Path())
                  for i, a in enumerate(np.arange(0, 6, 0.5)))  # fmt: skip
    for view in views:
        moved = view.world_from_camera @ pose.from_rotation_vector([0.05, -0.1, 0.0], [0.02, 0, 0.03])
        assert nearest_view(viewpoint(moved), views, 1.0) is view


def test_the_wipe_is_one_picture_on_the_left_and_the_other_on_the_right() -> None:
    left, right = np.zeros((5, 10, 3), np.float32), np.full((5, 10, 3), 0.5, np.float32)
    joined = wiped(left, right, 0.4)
    assert not joined[:, :3].any() and (joined[:, 5:] == 0.5).all() and (joined[:, 3:5] == 1).all()
    assert (wiped(left, right, 0.0)[:, 1:] == 0.5).all() and not wiped(left, right, 1.0)[:, :9].any()


def test_coarse_pictures_are_enlarged_and_fine_ones_left_alone() -> None:
    assert enlarged(np.full((10, 20, 3), 0.25, np.float32), 640).shape == (320, 640, 3)
    fine = np.zeros((10, 700, 3), np.float32)
    assert enlarged(fine, 640) is fine
