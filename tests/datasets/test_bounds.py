import numpy as np
import pytest

from datasets import bounds, images, pose
from datasets.camera_model import Camera
from datasets.scene import View

CAMERA = Camera(128, 96, 110, 110, 64, 48)


def ring(centre: tuple = (1.0, 2.0, 3.0), radius: float = 4.0, count: int = 12) -> list[View]:
    views = []
    for index in range(count):
        angle = 2 * np.pi * index / count
        height = 1.5 * np.sin(3 * angle)
        position = np.add(centre, (radius * np.cos(angle), radius * np.sin(angle), height))
        views.append(View(str(index), CAMERA, pose.look_at(position, centre), "train", None))
    return views


def test_focus_is_where_the_axes_meet() -> None:
    centre, spread = bounds.focus([view.world_from_camera for view in ring()])
    assert np.allclose(centre, [1, 2, 3], atol=1e-9) and spread > 0.3


def test_parallel_axes_have_no_focus_and_say_so() -> None:
    matrices = [pose.rigid(np.eye(3), (x, 0, 0)) for x in range(5)]
    centre, spread = bounds.focus(matrices)
    assert spread < 1e-12 and np.allclose(centre, [2, 0, 0])
    box, near, far = bounds.surroundings([View("", CAMERA, m, "train", None) for m in matrices])
    assert 0 < near < far == np.inf and (box[0] < box[1]).all() and box[0, 2] > 0


def test_depth_range_by_hand() -> None:
    """One camera at the origin looking along z, a box from z = 2 to 5."""
    view = View("", CAMERA, np.eye(4), "train", None)
    assert bounds.depth_range([view], [[-1, -1, 2], [1, 1, 5]]) == (2.0, 5.0)
    assert bounds.depth_range([view], [[-1, -1, -2], [1, 1, 5]]) == (0.05, 5.0)  # never behind the camera


def test_frustum_box_by_hand() -> None:
    view = View("", CAMERA, np.eye(4), "train", None)
    wide, high = 64 / 110, 48 / 110
    assert np.allclose(bounds.frustum_box([view], 1, 2), [[-2 * wide, -2 * high, 1], [2 * wide, 2 * high, 2]])


@pytest.mark.parametrize("lens", [{}, {"k1": -0.1, "cx": 60.0}])
def test_mask_box_holds_the_object_and_little_else(tmp_path, lens: dict) -> None:
    """An ellipsoid with half-axes 0.9, 0.5, 0.3 about (1, 2, 3), drawn exactly into masks."""
    from dataclasses import replace

    axes, centre = np.array([0.9, 0.5, 0.3]), np.array([1.0, 2.0, 3.0])
    camera = replace(CAMERA, **lens)
    views = []
    for view in ring():
        origin = (view.world_from_camera[:3, 3] - centre) / axes
        rays = camera.directions(camera.pixel_centres()) @ view.world_from_camera[:3, :3].T / axes
        b, a, c = rays @ origin, (rays**2).sum(-1), origin @ origin - 1
        path = tmp_path / f"{view.name}.png"
        images.write(path, np.uint8(255 * (b * b > a * c)))
        views.append(replace(view, camera=camera, image=path, mask=path))
    start = bounds.visible_box(views)
    box = bounds.mask_box(views, start)
    assert (start[1] - start[0] > 3).all()  # the premise: there is something to tighten
    assert (box[0] <= centre - axes).all() and (box[1] >= centre + axes).all()
    assert (box[1] - box[0] < 2 * axes + 0.3).all()  # mask cells of 2 px are 0.07 units here, on either side twice


def test_masks_that_exclude_everything_leave_the_box(tmp_path) -> None:
    images.write(tmp_path / "black.png", np.zeros((96, 128), np.uint8))
    views = [View(v.name, v.camera, v.world_from_camera, "train", v.image, tmp_path / "black.png") for v in ring()]
    assert np.array_equal(bounds.mask_box(views, [[0, 1, 2], [2, 3, 4]]), [[0, 1, 2], [2, 3, 4]])
