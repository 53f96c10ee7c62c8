"""The sequence of configurations, one per view, with the least travel."""

import itertools

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.paths import are_free

Joints = NDArray[np.float64]

DETOUR = 4.0  # cost of a path that is not straight, in radians of the fastest joint
COST_DIGITS = 9
"""Costs are rounded: mirror-symmetric sequences tie and the first is taken, whatever the last digits of the joint angles."""


def shortest(layers: list[Joints], obstacles: Obstacles) -> tuple[list[int], float]:
    """The sequence with the least travel: an index into each layer of (m, n) configurations, and its cost [rad].

    Only the paths of the best sequence so far are checked for collisions. A blocked one is charged a detour and the search
    is repeated, until every path of the best sequence has been checked.
    """
    costs = [_travel(a[:, None] - b[None]) for a, b in itertools.pairwise(layers)]
    known = [np.zeros(cost.shape, bool) for cost in costs]
    while True:
        chosen = _cheapest(layers, costs, obstacles.carrier.arm.home)
        unknown = [i for i in range(len(costs)) if not known[i][chosen[i], chosen[i + 1]]]
        if not unknown:
            return chosen, float(sum(cost[a, b] for cost, (a, b) in zip(costs, itertools.pairwise(chosen), strict=True)))
        starts = np.stack([layers[i][chosen[i]] for i in unknown])
        goals = np.stack([layers[i + 1][chosen[i + 1]] for i in unknown])
        for i, free in zip(unknown, are_free(starts, goals, obstacles), strict=True):
            known[i][chosen[i], chosen[i + 1]] = True
            if not free:
                costs[i][chosen[i], chosen[i + 1]] += DETOUR


def _travel(difference: Joints) -> NDArray[np.float64]:
    """Cost of (..., n) joint motions: the fastest joint decides, the others count a little."""
    return np.abs(difference).max(-1) + 0.05 * np.abs(difference).sum(-1)


def _cheapest(layers: list[Joints], costs: list[NDArray[np.float64]], home: Joints) -> list[int]:
    """Index into each layer of the cheapest sequence, by dynamic programming."""
    total, back = np.round(np.abs(layers[0] - home).max(-1), COST_DIGITS), []
    for cost in costs:
        through = np.round(total[:, None] + cost, COST_DIGITS)
        back.append(through.argmin(axis=0))
        total = through.min(axis=0)
    chosen = [int(total.argmin())]
    for previous in back[::-1]:
        chosen.append(int(previous[chosen[-1]]))
    return chosen[::-1]
