"""Ways around obstacles are free at every step, also between the steps that were checked."""

import numpy as np
import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.paths import are_free, between, find_path, is_free

MOUNT = RigDescription().carrier()
POST = np.array([[-0.65, -0.05, 0.0], [-0.45, 0.05, 0.6]])
"""Stands where the arm would sweep from one side to the other."""
OBSTACLES = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=POST)
LEFT = np.array([-0.9, -0.9, 1.3, -2.0, -1.57, 0.0])
RIGHT = np.array([0.9, -0.9, 1.3, -2.0, -1.57, 0.0])


def test_steps_are_small_and_include_both_ends():
    path = between(LEFT, RIGHT)
    assert (path[0] == LEFT).all() and (path[-1] == RIGHT).all() and np.abs(np.diff(path, axis=0)).max() <= 0.05 + 1e-9


def test_a_blocked_path_is_detected_and_avoided():
    assert OBSTACLES.margin(np.stack([LEFT, RIGHT])).min() > 0  # both ends are free
    assert not is_free(LEFT, RIGHT, OBSTACLES)  # and the straight path is not: the premise
    np.testing.assert_array_equal(are_free(np.stack([LEFT, LEFT]), np.stack([RIGHT, LEFT]), OBSTACLES), [False, True])
    path = find_path(LEFT, RIGHT, OBSTACLES)
    assert path is not None and (path[-1] == RIGHT).all() and len(path) > 1
    here = LEFT
    for there in path:
        finer = np.linspace(here, there, 200)
        assert OBSTACLES.margin(finer).min() > -0.005  # the arm moves less than 5 mm between two checked steps
        here = there


def test_the_search_is_repeatable():
    first, second = find_path(LEFT, RIGHT, OBSTACLES), find_path(LEFT, RIGHT, OBSTACLES)
    np.testing.assert_array_equal(first, second)


def test_no_path_into_an_obstacle():
    inside = np.array([0.0, -0.9, 1.3, -2.0, -1.57, 0.0])
    assert OBSTACLES.margin(inside[None])[0] < 0
    assert find_path(LEFT, inside, OBSTACLES, tries=20) is None


@pytest.mark.parametrize("goal", [LEFT, LEFT - [0.2, 0, 0, 0, 0.1, 0]])
def test_a_free_straight_path_is_taken(goal):
    path = find_path(LEFT, goal, OBSTACLES)
    assert path is not None and len(path) == 1 and (path[0] == goal).all()
