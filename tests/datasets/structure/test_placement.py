from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure import matching
from koala3d.datasets.structure.placement import Reprojection, reprojection_of


def turned(scene: Scene, sigma: float) -> Scene:
    """The scene with every camera turned on the spot at random, `sigma` about each axis [rad]."""
    random = np.random.default_rng(0)
    turns = [pose.from_rotation_vector(random.normal(0, sigma, 3)) for _ in scene.views]
    return scene.with_views(
        tuple(replace(v, world_from_camera=v.world_from_camera @ turn) for v, turn in zip(scene.views, turns, strict=True))
    )


def found_in(scene: Scene) -> Reprojection:
    matrices = np.stack([view.world_from_camera for view in scene.views])
    return reprojection_of(matching.matched(scene.views, matching.pairs_of(matrices, np.zeros(3))))


def test_right_poses_are_not_doubted(two_walls: Callable[..., Scene]) -> None:
    found = found_in(two_walls())
    assert found.points > 200 and found.median_px < 0.45 and not found.doubtful
    assert 3.3 < found.depth < 7.5, "the square stands 4 away, the wall 6"
    assert "matched points miss their features by 0." in found.words()


def test_turned_cameras_are_doubted_by_about_their_angle(two_walls: Callable[..., Scene]) -> None:
    sigma = 1.5 / 220  # a pixel and a half
    found = found_in(turned(two_walls(), sigma))
    assert found.doubtful and sigma / 3 < found.beyond_rad < sigma  # a track follows the views that agree, and drops the others


@pytest.mark.parametrize(("points", "median", "doubtful"), [(50, 2.0, False), (500, 0.5, False), (500, 0.8, True)])
def test_a_few_points_say_nothing(points: int, median: float, doubtful: bool) -> None:
    found = Reprojection(points, median, 0.001, 1.0)
    assert found.doubtful is doubtful and ("too few" in found.words()) == (points == 50)


def test_without_matches_nothing_is_said(two_walls: Callable[..., Scene]) -> None:
    scene = two_walls()
    assert found_in(scene.with_views(scene.views[:2])) == Reprojection(0, 0.0, 0.0, 0.0)
