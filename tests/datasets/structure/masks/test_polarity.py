"""Whether white or black is the object, on masks of a ball seen from a ring."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.datasets.structure.bounds import visible_box
from koala3d.datasets.structure.masks import polarity
from koala3d.datasets.structure.masks.silhouette import silhouettes

CENTRE = np.array([1.0, 2.0, 3.0])


@pytest.fixture
def ball(camera_ring: Callable[..., list[View]], tmp_path: Path) -> Callable[..., list[View]]:
    """Factory of views of a ball at the cameras' focus: its radius, the focal length, and whether black is the ball."""

    def make(radius: float, focal: float, *, black: bool, count: int = 12) -> list[View]:
        camera = Camera(128, 96, focal, focal, 64, 48)
        views = []
        for number, view in enumerate(camera_ring(centre=tuple(CENTRE), count=count)):
            path = tmp_path / f"{number}.png"
            view = replace(view, camera=camera, mask=path)
            rays = camera.directions(camera.pixel_centres()) @ view.world_from_camera[:3, :3].T
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            to_centre = CENTRE - view.world_from_camera[:3, 3]
            along = rays @ to_centre
            hit = to_centre @ to_centre - along**2 < radius**2
            images.write(path, np.uint8(255 * (hit != black)))
            views.append(view)
        return views

    return make


def inverted(views: list[View]) -> str:
    return polarity.inverted(silhouettes(views), visible_box(views))


@pytest.mark.parametrize("black", [False, True])
@pytest.mark.parametrize(
    ("radius", "focal", "border"),
    [(0.9, 110.0, (0.0, 0.0)), (1.7, 120.0, (0.2, 0.6)), (1.7, 150.0, (0.6, 0.95))],
    ids=["inside the picture", "cut at its edges", "filling it"],
)
def test_a_ball_is_told_from_what_is_around_it(
    ball: Callable[..., list[View]], radius: float, focal: float, border: tuple[float, float], black: bool
) -> None:
    views = ball(radius, focal, black=black)
    edge = np.mean([polarity.border_white(view.read_mask()[..., 0]) for view in views])
    assert border[0] <= (1 - edge if black else edge) <= border[1]  # the premise
    assert bool(inverted(views)) == black


def test_the_others_agree_on_a_body_only(ball: Callable[..., list[View]]) -> None:
    views = ball(0.9, 110.0, black=False)
    white = silhouettes(views)
    assert polarity.agreement(white, visible_box(views)) > 0.7  # the widened rim of a small ball is the rest
    assert polarity.agreement([replace(one, inside=~one.inside) for one in white], visible_box(views)) < 0.2


def test_masks_that_leave_out_passers_by_are_not_inverted(ball: Callable[..., list[View]]) -> None:
    """White nearly everywhere, black where somebody walked: the black has no common body."""
    views = ball(0.9, 110.0, black=False)
    random = np.random.default_rng(0)
    for view in views:
        white = np.full((96, 128), 255, np.uint8)
        left = random.integers(0, 110)
        white[20:90, left : left + 18] = 0
        assert view.mask is not None
        images.write(view.mask, white)
    assert not inverted(views)


@pytest.mark.parametrize(("radius", "focal"), [(0.9, 110.0), (1.7, 120.0)], ids=["inside the picture", "cut at its edges"])
def test_an_object_is_no_surroundings(ball: Callable[..., list[View]], radius: float, focal: float) -> None:
    assert not polarity.of_surroundings(silhouettes(ball(radius, focal, black=False)))


@pytest.mark.parametrize("kind", ["gripper", "hand", "rim"])
def test_a_thing_in_the_way_is_no_background(ball: Callable[..., list[View]], kind: str) -> None:
    """At the lower edge of each picture, somewhere else in each, or around the circle of a lens."""
    views, random = ball(0.9, 110.0, black=False), np.random.default_rng(0)
    rows, columns = np.mgrid[:96, :128]
    for view in views:
        middle = random.uniform((20, 30), (76, 98))
        black = {
            "gripper": (rows > 70) & (abs(columns - 64) < 40),
            "hand": np.hypot(rows - middle[0], columns - middle[1]) < 20,
            "rim": np.hypot(rows - 48, columns - 64) > 66,
        }[kind]
        images.write(view.mask, np.uint8(255 * ~black))
    assert polarity.of_surroundings(silhouettes(views)) and not inverted(views)
