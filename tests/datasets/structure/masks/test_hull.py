from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks.hull import UNEXPLAINED, _hull_within, visual_hull
from koala3d.datasets.structure.masks.silhouette import silhouettes

AXES, CENTRE = np.array([0.9, 0.5, 0.3]), np.array([1.0, 2.0, 3.0])


def draw_masks(views: list[View], folder: Path, camera: Camera, axes: np.ndarray = AXES) -> list[View]:
    """The views with exact masks of an ellipsoid."""
    drawn = []
    for view in views:
        origin = (view.world_from_camera[:3, 3] - CENTRE) / axes
        rays = camera.directions(camera.pixel_centres()) @ view.world_from_camera[:3, :3].T / axes
        b, a, c = rays @ origin, (rays**2).sum(-1), origin @ origin - 1
        path = folder / f"{view.name}.png"
        images.write(path, np.uint8(255 * (b * b > a * c)))
        drawn.append(replace(view, camera=camera, image=path, mask=path))
    return drawn


@pytest.mark.parametrize("lens", [{}, {"k1": -0.1, "cx": 60.0}])
def test_hull_holds_the_object_and_little_else(camera_ring, tmp_path: Path, lens: dict) -> None:
    views = draw_masks(camera_ring(), tmp_path, replace(Camera(128, 96, 110, 110, 64, 48), **lens))
    start = bounds.visible_box(views)
    hull = visual_hull(silhouettes(views), start)
    assert (start[1] - start[0] > 3).all()  # the premise: there is something to tighten
    assert (hull.box[0] <= CENTRE - AXES).all() and (hull.box[1] >= CENTRE + AXES).all() and hull.views_used == 12
    assert (hull.box[1] - hull.box[0] < 2 * AXES + 0.3).all()  # pixels are 0.035 units here, a cell of the hull is 0.04
    surface = np.random.default_rng(0).normal(size=(2000, 3))
    surface = CENTRE + AXES * surface / np.linalg.norm(surface, axis=1, keepdims=True)
    depths = np.stack([(surface - v.world_from_camera[:3, 3]) @ v.world_from_camera[:3, 2] for v in views])
    near, far = hull.depth_range(views)
    assert near <= depths.min() < near + 0.3 and far - 0.3 < depths.max() <= far
    loose = bounds.depth_range(views, hull.box)
    assert near >= loose[0] and far <= loose[1]  # corners of a box stick out


def test_box_grows_where_the_object_goes_on_beyond_the_pictures(camera_ring, tmp_path: Path) -> None:
    """A rod of 1.8 units that sticks out of pictures of 1 unit, and out of the box that is searched first."""
    rod = np.array([0.9, 0.15, 0.15])
    views = draw_masks(camera_ring(), tmp_path, Camera(128, 96, 520, 520, 64, 48), rod)
    start = bounds.visible_box(views)
    assert start[0, 0] > CENTRE[0] - rod[0] + 0.1, "premise: the box ends before the object does"
    hull, found = visual_hull(silhouettes(views), start), silhouettes(views)
    within = _hull_within(found, start, 4)
    assert within is not None and within.unexplained(found) > UNEXPLAINED >= hull.unexplained(found)
    assert (hull.box[0, 0] < start[0, 0] - 0.1) and (hull.box[1, 0] > start[1, 0] + 0.1)


def test_the_wrong_mask_of_one_view_leaves_the_box(camera_ring, tmp_path: Path) -> None:
    views = draw_masks(camera_ring(count=24), tmp_path, Camera(128, 96, 110, 110, 64, 48))
    images.write(tmp_path / "black.png", np.zeros((96, 128), np.uint8))
    hull = visual_hull(silhouettes([replace(views[0], mask=tmp_path / "black.png"), *views[1:]]), bounds.visible_box(views))
    assert (hull.box[0] <= CENTRE - AXES).all() and (hull.box[1] >= CENTRE + AXES).all()


def test_masks_that_exclude_everything_leave_the_box(camera_ring, tmp_path: Path) -> None:
    images.write(tmp_path / "black.png", np.zeros((96, 128), np.uint8))
    views = [replace(view, mask=tmp_path / "black.png") for view in camera_ring()]
    hull = visual_hull(silhouettes(views), [[0, 1, 2], [2, 3, 4]])
    assert np.array_equal(hull.box, [[0, 1, 2], [2, 3, 4]]) and hull.views_used == 0
    assert hull.depth_range(views) == bounds.depth_range(views, hull.box)
