"""Collision-free paths in joint space: straight where possible, otherwise found by a bidirectional tree search.

On a straight path all joints move in proportion, as in the controller's movej. What is said of a path holds for all of it, not
only for the configurations that were looked at: the distance by which a part may have moved since is subtracted from its margin.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.planning.obstacles import Obstacles

Joints = NDArray[np.float64]
Array = NDArray[np.float64]

STRIDE = 0.4  # length of one branch of a tree, in the fastest joint [rad]
PIECE = 0.4  # of a path, in the fastest joint, that is looked at in one place before it is divided [rad]
FINEST_M = 2e-4
"""A piece on which no part moves farther from where it was looked at is not divided any more."""
LEAVE = 0.05
"""On this much of its path, in the fastest joint, an arm that stands too close may still be so, but not closer [rad]."""


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of straight paths: (m,) `path` is the index of each one's path, which goes from `start` by `change`, (paths, n).

    `middle` is the place of its middle on the path, from 0 to 1, and `half` half its length.
    """

    start: Array
    change: Array
    path: NDArray[np.int64]
    middle: Array
    half: Array

    @classmethod
    def of(cls, starts: Array, goals: Array) -> "_Pieces":
        """Whole paths, with the part that `LEAVE` is about in a piece of its own."""
        travel = np.abs(goals - starts).max(axis=1)
        numbers, middles, halves = [], [], []
        for number, length in enumerate(travel):
            leave = min(LEAVE / max(length, 1e-12), 1.0)
            count = int(np.ceil(max(length - LEAVE, 0.0) / PIECE)) + 1
            edges = np.concatenate([[0.0], np.linspace(leave, 1.0, count)])
            numbers += [number] * count
            middles.append((edges[1:] + edges[:-1]) / 2)
            halves.append((edges[1:] - edges[:-1]) / 2)
        return cls(starts, goals - starts, np.array(numbers), np.concatenate(middles), np.concatenate(halves))

    @property
    def leaving(self) -> NDArray[np.bool_]:
        """(m,) whether a piece lies within `LEAVE` of the start."""
        travel = np.abs(self.change).max(axis=1)[self.path]
        return np.asarray((self.middle + self.half) * travel <= LEAVE + 1e-9)

    def kept(self, which: NDArray[np.bool_]) -> "_Pieces":
        """Only these."""
        return _Pieces(self.start, self.change, self.path[which], self.middle[which], self.half[which])

    def halved(self) -> "_Pieces":
        """Both halves of each."""
        quarter = self.half / 2
        middle = np.concatenate([self.middle - quarter, self.middle + quarter])
        return _Pieces(self.start, self.change, np.tile(self.path, 2), middle, np.tile(quarter, 2))

    def margins(self, obstacles: Obstacles) -> tuple[Array, Array, Array]:
        """(m,) margin in the middle of each piece, one that it nowhere falls below, and how far a part moves from there [m]."""
        change = self.change[self.path]
        joints = self.start[self.path] + self.middle[:, None] * change
        room = obstacles.rooms(joints)
        half = self.half[:, None]
        moved = half * obstacles.sweep.speeds(joints, change) + half**2 / 2 * obstacles.sweep.bends(self.change)[self.path]
        return room.min(-1), (room - moved).min(-1), moved.max(-1)


def is_free(start: Joints, goal: Joints, obstacles: Obstacles) -> bool:
    """Whether all of the straight path is free; see `are_free`."""
    return bool(are_free(np.asarray(start)[None], np.asarray(goal)[None], obstacles)[0])


def are_free(starts: Joints, goals: Joints, obstacles: Obstacles) -> NDArray[np.bool_]:
    """(m,) whether the straight paths from (m, n) starts to goals are free, their ends included.

    An arm that stands too close may leave, see `LEAVE`. A start beyond a limit of the joints or of the cable is not refused:
    these limits are convex, so that the way back inside does not lead farther out.
    """
    free = obstacles.free(goals)
    floor = np.minimum(obstacles.margin(starts), 0.0)
    pieces = _Pieces.of(starts, goals)
    pieces = pieces.kept(free[pieces.path])
    while len(pieces.path):
        here, least, moved = pieces.margins(obstacles)
        allowed = np.where(pieces.leaving, floor[pieces.path], 0.0)
        allowed = np.where(allowed < 0, allowed - FINEST_M, 0.0)
        bad = (here < allowed) | ((least < allowed) & (moved < FINEST_M))
        free[pieces.path[bad]] = False
        pieces = pieces.kept((least < allowed) & free[pieces.path]).halved()
    return free


def least_margin(path: Joints, obstacles: Obstacles, within_m: float = 1e-3) -> float:
    """A margin [m] that the arm nowhere falls below on the straight paths through (m, n) configurations.

    The true one is at most `within_m` larger.
    """
    pieces, found = _Pieces.of(path[:-1], path[1:]), float(obstacles.margin(path).min())
    closest = found
    while len(pieces.path):
        here, least, _ = pieces.margins(obstacles)
        closest = min(closest, float(here.min()))
        done = least >= closest - within_m
        found = min(found, float(least[done].min(initial=np.inf)))
        pieces = pieces.kept(~done).halved()
    return found


def find_path(start: Joints, goal: Joints, obstacles: Obstacles, *, seed: int = 0, tries: int = 2000) -> list[Joints] | None:
    """Configurations to visit after `start`, the last being `goal`, with free straight paths between; None: none found.

    RRT-Connect (Kuffner and LaValle 2000) in a box of joint angles around start and goal, then shortened.
    """
    if is_free(start, goal, obstacles):
        return [goal]
    if not obstacles.free(np.asarray(goal)[None])[0]:
        return None
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
