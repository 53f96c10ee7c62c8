from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View
from koala3d.reconstruct.output.mesh import surface_distance

CAMERA = Camera(100, 100, 90.0, 90.0, 50.0, 50.0)
BOX = np.array([[-0.2, -0.2, -0.2], [0.2, 0.2, 0.2]])


def around(count: int = 6) -> tuple[View, ...]:
    """Cameras on a ring a little above, and one at the top."""
    places = [(0.5 * np.cos(a), 0.5 * np.sin(a), 0.1) for a in 2 * np.pi * np.arange(count) / count] + [(0.0, 0.0, 0.5)]
    return tuple(View(str(i), CAMERA, pose.look_at(place, (0, 0, 0)), "train", Path()) for i, place in enumerate(places))


def ball(radius: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=5, radius=radius)


def test_equal_surfaces_are_nowhere_apart() -> None:
    found = surface_distance.compare(ball(), ball(), around(), BOX, count=20_000)
    assert found["chamfer_mm"] < 0.02 and found["f_score"] == 1
    assert found["threshold_mm"] == pytest.approx(1e3 * 0.01 * 0.2 * np.sqrt(3), rel=1e-3)


def test_a_larger_ball_is_off_by_the_difference() -> None:
    """Its facets of 4 mm leave 0.02 mm."""
    found = surface_distance.compare(ball(0.105), ball(0.1), around(), BOX, count=20_000)
    assert found["accuracy_mm"] == pytest.approx(5, abs=0.05) and found["completeness_mm"] == pytest.approx(5, abs=0.05)
    assert found["f_score"] == 0, "5 mm is beyond the threshold of 3.5 mm"


def test_surface_that_no_camera_sees_is_not_compared() -> None:
    """A cavity inside, and a plate far below that the ball hides from the camera above."""
    inside = trimesh.util.concatenate([ball(0.1), ball(0.05)])
    found = surface_distance.compare(inside, ball(0.1), around(), BOX, count=40_000)
    assert found["accuracy_mm"] < 0.02
    above = around()[-1:]
    plate = trimesh.creation.box((0.05, 0.05, 0.001))
    plate.apply_translation([0, 0, -0.15])
    hidden = surface_distance.compare(trimesh.util.concatenate([ball(0.1), plate]), ball(0.1), above, BOX, count=40_000)
    assert hidden["accuracy_mm"] < 0.02
    seen = surface_distance.compare(trimesh.util.concatenate([ball(0.1), plate]), ball(0.1), around(), BOX, count=40_000)
    assert seen["accuracy_mm"] > 0.1, "from the side the plate is seen"


def test_the_floor_and_what_is_outside_the_box_do_not_count() -> None:
    floor = trimesh.creation.box((0.6, 0.6, 0.004))
    floor.apply_translation([0, 0, -0.2])
    both = trimesh.util.concatenate([ball(), floor])
    found = surface_distance.compare(both, ball(), around(), BOX, count=40_000)
    assert found["accuracy_mm"] < 0.02
    assert surface_distance.compare(both, ball(), around(), BOX, floor=0, count=40_000)["accuracy_mm"] > 1, "no table is there"


def test_nothing_to_compare_is_none() -> None:
    away = ball()
    away.apply_translation([5, 0, 0])
    assert surface_distance.compare(away, ball(), around(), BOX, count=1000) is None


def test_large_pictures_hide_as_small_ones_do() -> None:
    points, _ = trimesh.sample.sample_surface(ball(), 40_000, seed=0)
    view = around()[0]
    large = View("large", CAMERA.scaled(2000, 2000), view.world_from_camera, "train", None)  # type: ignore[arg-type]
    small = surface_distance.visible(points, (view,))
    assert 0.2 < small.mean() < 0.5, "less than half of a ball is seen from one side, less what is seen at a grazing angle"
    assert np.mean(surface_distance.visible(points, (large,)) == small) > 0.95
