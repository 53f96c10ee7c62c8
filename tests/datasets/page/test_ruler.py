"""The ruler: which point a click means, distances, and the option that the page suggests."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.page import Page, open_page
from koala3d.datasets.page.ruler import Ruler, along_ray, sighted
from koala3d.datasets.process.world.scale import KnownLength, by_length
from koala3d.datasets.scene import Scene, Sightings, View

POINTS = np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0, 1.0], [0.0, 0.4, 0.1]])
CAMERA = Camera(200, 160, 180, 180, 100, 80)


@pytest.fixture
def scene() -> Scene:
    """Four points, of which three views see the first two, and one view the others."""
    poses = [pose.look_at((x, -3, 0.5), (0, 0, 0)) for x in (-1.0, 0.0, 1.5)]
    views = tuple(View(f"a {k}", CAMERA, matrix, "train", Path("none")) for k, matrix in enumerate(poses))
    index = np.array([(point, view) for point in (0, 1) for view in range(3)] + [(2, 0), (3, 0)])
    local = [(POINTS[p] - poses[v][:3, 3]) @ poses[v][:3, :3] for p, v in index]
    sightings = Sightings(tuple(v.name for v in views), index, CAMERA.project(local))
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    return Scene("four", views, 1.0, np.inf, box, "scene", points=POINTS, sightings=sightings)


@pytest.fixture
def page() -> Iterator[Page]:
    with open_page("ruler", 0) as opened:
        yield opened


def test_a_click_means_the_point_in_front() -> None:
    assert along_ray(POINTS, (0, 0, -2), (0, 0, 1)) == 0  # the third is behind it
    assert along_ray(POINTS, (0, 0, 3), (0, 0, -5)) == 2
    assert along_ray(POINTS, (0.3, -3, 0.02), (0, 1, 0)) == 1
    assert along_ray(POINTS, (0, 0, -2), (0, 0, -1)) is None and along_ray(POINTS, (0, 0, -2), (1, 0, 0)) is None


def test_the_suggested_option_gives_the_scene_its_length(scene: Scene) -> None:
    ends = [sighted(scene, 0), sighted(scene, 1)]
    assert ends[0] is not None and ends[1] is not None and ends[0].startswith("a 0:") and "+a 2:" in ends[0]
    factor, _ = by_length(scene.views, KnownLength.parse(ends[0], ends[1], 0.06))
    assert factor == pytest.approx(0.2, rel=0.01)  # pixels are written with one digit
    assert sighted(scene, 2) is None and sighted(replace(scene, sightings=None), 0) is None


def test_two_clicks_measure_and_a_third_begins_anew(scene: Scene, page: Page) -> None:
    ruler = Ruler(page, scene, 0.05)
    ruler.switch(True)
    ruler.click((0, -3, 0), (0, 1, 0))
    assert ruler.ends == [0] and "another" in ruler.words()
    ruler.click((9, 9, 9), (1, 1, 1))
    assert ruler.ends == [0]
    ruler.click((0.3, -3, 0), (0, 1, 0))
    assert ruler.ends == [0, 1] and "**0.3 units**" in ruler.words() and "--known-length 'a 0:" in ruler.words()
    assert page.scene.get_handle_by_name("/ruler/B/ball") is not None
    ruler.click((0, 0.4, -3), (0, 0, 1))
    assert ruler.ends == [3] and page.scene.get_handle_by_name("/ruler/B/ball") is None
    ruler.click((0, 0, 5), (0, 0, -1))
    assert ruler.words() == "**0.9849 units**"  # no two views saw them
    ruler.switch(False)
    assert not ruler.ends and page.scene.get_handle_by_name("/ruler/A/ball") is None
