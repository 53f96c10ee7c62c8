"""One value per view from differences measured between pairs of views: gains, sharpness.

Values x and measured differences d of pairs (i, j) obey x[i] - x[j] = d, which fixes x up to a constant. Pairs that contradict
the others, as highlights make them do, count less.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

HUBER = 1.5
"""Residual in standard deviations from which a pair counts less (Huber 1964)."""
ROUNDS = 10


def robust_median(values: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median of (n, k) values along the first axis, and its standard deviation from the median absolute deviation, both (k,)."""
    middle = np.asarray(np.median(values, axis=0), np.float64)
    spread = 1.4826 * np.median(np.abs(values - middle), axis=0)
    return middle, 1.2533 * spread / np.sqrt(len(values))  # a median's deviation is 1.2533 times a mean's


def values_of_views(
    count: int, pairs: Sequence[tuple[int, int]], differences: NDArray[np.float64], std: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values of `count` views, relative to the median view, from (m,) differences of m pairs with standard deviations.

    Least squares with Huber's weights. What pairs contradict each other beyond `std` enlarges the deviations.

    Returns:
        (values, standard deviations), both (count,); NaN for views that no chain of pairs joins to the largest group.
    """
    values, deviations = np.full(count, np.nan), np.full(count, np.nan)
    group = _largest_group(count, pairs)
    kept = [k for k, (i, _) in enumerate(pairs) if group[i]]
    if not kept:
        return values, deviations
    system = np.zeros((len(kept), count))
    for row, k in enumerate(kept):
        system[row, pairs[k][0]], system[row, pairs[k][1]] = 1.0, -1.0
    system, target, variance = system[:, group], differences[kept], np.maximum(std[kept], 1e-4) ** 2
    solution, weight, extra = np.zeros(int(group.sum())), 1 / variance, 0.0
    for _ in range(ROUNDS):
        normal = np.linalg.pinv(system.T @ (weight[:, None] * system), hermitian=True)
        solution = normal @ (system.T @ (weight * target))
        residual = np.abs(target - system @ solution)
        free = len(kept) / max(len(kept) - len(solution) + 1, 1)
        extra = max((1.4826 * float(np.median(residual))) ** 2 * free - float(np.median(variance)), 0.0)
        scaled = residual / np.sqrt(variance + extra)
        weight = np.minimum(1.0, HUBER / np.maximum(scaled, 1e-12)) / (variance + extra)
    values[group] = solution - np.median(solution)
    deviations[group] = np.sqrt(np.diag(np.linalg.pinv(system.T @ (weight[:, None] * system), hermitian=True)))
    return values, deviations


def _largest_group(count: int, pairs: Sequence[tuple[int, int]]) -> NDArray[np.bool_]:
    """(count,) True for the views of the largest group joined by pairs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.asarray(pairs, np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    found = label == np.bincount(label).argmax()
    return found if found.sum() > 1 else np.zeros(count, bool)
