"""Collision-free paths in joint space: straight where possible, otherwise found by a bidirectional tree search.

On a straight path all joints move in proportion, as in the controller's movej.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.planning.obstacles import Obstacles

Joints = NDArray[np.float64]

STEP = 0.05  # largest distance of two checked configurations on a path, in the fastest joint [rad]
STRIDE = 0.4  # length of one branch of a tree, in the fastest joint [rad]


def between(start: Joints, goal: Joints) -> Joints:
    """(m, n) configurations from `start` to `goal`, both included, at most STEP apart."""
    count = int(np.ceil(np.abs(goal - start).max() / STEP)) + 1
    return np.linspace(start, goal, max(count, 2))


def is_free(start: Joints, goal: Joints, obstacles: Obstacles) -> bool:
    """Whether the straight path is free. The start is not checked: an arm that stands too close may leave."""
    return bool(obstacles.free(between(start, goal)[1:]).all())


def are_free(starts: Joints, goals: Joints, obstacles: Obstacles) -> NDArray[np.bool_]:
    """(m,) `is_free` of many paths at once, with (m, n) starts and goals."""
    paths = [between(start, goal)[1:] for start, goal in zip(starts, goals, strict=True)]
    free = obstacles.free(np.concatenate(paths))
    edges = np.cumsum([0] + [len(path) for path in paths])
    return np.array([free[a:b].all() for a, b in itertools.pairwise(edges)])


def find_path(start: Joints, goal: Joints, obstacles: Obstacles, *, seed: int = 0, tries: int = 2000) -> list[Joints] | None:
    """Configurations to visit after `start`, the last being `goal`, with free straight paths between; None: none found.

    RRT-Connect (Kuffner and LaValle 2000) in a box of joint angles around start and goal, then shortened.
    """
    if is_free(start, goal, obstacles):
        return [goal]
    rng = np.random.default_rng(seed)
    low = np.maximum(np.minimum(start, goal) - 1.5, obstacles.carrier.arm.lower)
    high = np.maximum(np.minimum(np.maximum(start, goal) + 1.5, obstacles.carrier.arm.upper), low)
    near, far = _Tree(start), _Tree(goal)
    for _ in range(tries):
        reached = near.grow(rng.uniform(low, high), obstacles)
        if reached is not None:
            met = reached
            while (met_next := far.grow(met, obstacles)) is not None:
                if np.allclose(met_next, met):
                    one, other = near.path(), far.path()
                    path = one + other[::-1][1:]
                    path = path if np.allclose(path[0], start) else path[::-1]
                    return _shorten(path, obstacles, rng)[1:]
        near, far = far, near
    return None


class _Tree:
    def __init__(self, root: Joints) -> None:
        self.nodes, self.parents = [root], [-1]

    def grow(self, towards: Joints, obstacles: Obstacles) -> Joints | None:
        """Add a node one stride from the nearest one; returns it, or None where the path is blocked."""
        distances = np.abs(np.stack(self.nodes) - towards).max(axis=1)
        parent = int(distances.argmin())
        share = min(1.0, STRIDE / max(distances[parent], 1e-12))
        node = self.nodes[parent] + share * (towards - self.nodes[parent])
        if share == 1.0:
            node = towards
        if not is_free(self.nodes[parent], node, obstacles):
            return None
        self.nodes.append(node)
        self.parents.append(parent)
        return node

    def path(self) -> list[Joints]:
        """From the root to the newest node."""
        path, index = [], len(self.nodes) - 1
        while index >= 0:
            path.append(self.nodes[index])
            index = self.parents[index]
        return path[::-1]


def _shorten(path: list[Joints], obstacles: Obstacles, rng: np.random.Generator) -> list[Joints]:
    for _ in range(60):
        if len(path) < 3:
            break
        first, last = sorted(rng.choice(len(path), 2, replace=False))
        if last - first > 1 and is_free(path[first], path[last], obstacles):
            path = path[: first + 1] + path[last:]
    return path
