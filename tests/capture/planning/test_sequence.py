"""The sequence with the least travel, against trying all of them."""

import itertools

import numpy as np

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.paths import is_free
from koala3d.capture.planning.sequence import DETOUR, shortest

HOME = load_arm("ur5e").home
MOUNT = RigDescription().carrier()
NOTHING = Obstacles(MOUNT, -1.0)  # a negative clearance: nothing is ever too close


def cost(path: list[np.ndarray], obstacles: Obstacles) -> float:
    """Travel of the fastest joint from view to view, a twentieth of that of all joints, and detours."""
    total = 0.0
    for start, goal in itertools.pairwise(path):
        total += np.abs(goal - start).max() + 0.05 * np.abs(goal - start).sum()
        total += 0.0 if is_free(start, goal, obstacles) else DETOUR
    return total


def test_it_is_the_cheapest_of_all_sequences() -> None:
    rng = np.random.default_rng(0)
    layers = [HOME + rng.normal(0, 0.8, (count, 6)) for count in (3, 4, 2, 3)]
    chosen, found = shortest(layers, NOTHING)
    start = lambda path: np.abs(path[0] - HOME).max()  # noqa: E731
    every = [
        [layer[i] for layer, i in zip(layers, indices, strict=True)] for indices in itertools.product(*map(range, (3, 4, 2, 3)))
    ]
    best = min(every, key=lambda path: start(path) + cost(path, NOTHING))
    np.testing.assert_array_equal([layer[i] for layer, i in zip(layers, chosen, strict=True)], best)
    assert abs(found - cost(best, NOTHING)) < 1e-9


def test_a_blocked_path_is_avoided_where_another_costs_less() -> None:
    post = np.array([[-0.65, -0.05, 0.0], [-0.45, 0.05, 0.6]])
    obstacles = Obstacles(MOUNT, 0.02, table_z=0.0, object_corners=post)
    left, right = np.array([-0.9, -0.9, 1.3, -2.0, -1.57, 0.0]), np.array([0.9, -0.9, 1.3, -2.0, -1.57, 0.0])
    same_side = left + 2.0 * np.eye(6)[5]
    assert not is_free(left, right, obstacles) and is_free(left, same_side, obstacles), "the premise"
    assert np.abs(same_side - left).max() > np.abs(right - left).max()  # further, but free
    chosen, _ = shortest([left[None], np.stack([right, same_side])], obstacles)
    assert chosen == [0, 1]
    only, price = shortest([left[None], right[None]], obstacles)
    assert only == [0, 0] and price > DETOUR  # without an alternative it is charged the detour


def test_one_view_is_taken_by_the_configuration_nearest_to_home() -> None:
    chosen, found = shortest([np.stack([HOME + 2.0, HOME + 0.1, HOME - 1.0])], NOTHING)
    assert (chosen, found) == ([1], 0.0)
