import itertools

import numpy as np

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import duration, plan
from koala3d.capture.planning.order import TURN_M, short_order
from koala3d.datasets import pose

MOUNT = RigDescription().carrier()


def length(poses, order):
    """The way through the poses, added up one by one."""
    total = 0.0
    for a, b in itertools.pairwise(order):
        turn = np.arccos(np.clip(poses[a][:3, 2] @ poses[b][:3, 2], -1, 1))
        total += np.linalg.norm(poses[a][:3, 3] - poses[b][:3, 3]) + TURN_M * turn
    return total


def test_it_is_as_short_as_any_order_of_few_views():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        poses = np.stack([pose.look_at(rng.uniform((-0.5, -0.5, 0.5), (0.5, 0.5, 1.5)), (0, 0, 0)) for _ in range(7)])
        found = short_order(poses)
        best = min(length(poses, (0, *rest)) for rest in itertools.permutations(range(1, 7)))
        assert sorted(found) == list(range(7)) and found[0] == 0
        assert length(poses, found) < 1.1 * best  # two-opt ends in a local minimum


def test_views_in_a_muddle_are_put_in_line():
    poses = np.stack([pose.look_at((x, 0, 1), (x, 0, 0)) for x in (0.0, 0.4, 0.1, 0.3, 0.2)])
    assert short_order(poses) == [0, 2, 4, 3, 1]


def test_a_plan_in_short_order_has_every_view_once_and_takes_no_longer():
    path = "calibration_demo"
    given, short = (load_trajectory(path, overrides=[f"motion.order={order}"]) for order in ("given", "shortest"))
    first, second = plan(given, MOUNT), plan(short, MOUNT)
    assert sorted(view.viewpoint.name for view in second) == [view.viewpoint.name for view in first]
    assert duration(short, second, MOUNT) < duration(given, first, MOUNT)
