import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.datasets.structure import bounds

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


def test_parallel_axes_have_no_focus() -> None:
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


def test_bounds_about_points_by_hand() -> None:
    """Cameras 4 from a cloud of half-width 0.5, all of which they see, and a few points that only one of them sees."""
    views = ring()
    random = np.random.default_rng(0)
    cloud = np.add(random.uniform(-0.5, 0.5, (4000, 3)), (1, 2, 3))
    behind_one = views[0].world_from_camera[:3, 3] * 2 - [1, 2, 3]  # as far behind the first camera as the centre is before it
    found = bounds.about_points(views, np.concatenate([cloud, behind_one + random.normal(0, 0.01, (50, 3))]))
    assert found is not None
    box, near, far = found
    assert np.allclose(box, [[0.46, 1.46, 2.46], [1.54, 2.54, 3.54]], atol=0.03)  # 98% of 1, and a tenth more
    assert 0.8 * 2.9 < near < 0.8 * 3.6 and far > 2 * 4.4
    assert bounds.about_points(views, cloud[: bounds.FEWEST_POINTS - 1]) is None
    assert bounds.about_points(views, np.zeros((0, 3))) is None
