"""Exposure and white balance of each view, from the light of points that several views see.

A view's gains multiply its linear light, one per colour. Matched points whose rays meet compare the gains of two views; pairs of
views are joined by least squares with robust weights. The gains count from the median view.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.scene import View
from datasets.structure.matching import Matches
from datasets.structure.triangulate import explained

DARK, BRIGHT = 0.01, 0.9
"""Linear light between which a pixel is neither black nor clipped."""
FEWEST = 10
"""Matches from which a pair of views is compared."""
SURE, CLEAR, LARGE = 5.0, 2.0, float(np.log(1.4))
"""A view differs where its log gain exceeds so many standard deviations, so many times the spread of single points, and this:
shading alone reaches 1.3 on shiny objects."""
TINTED = float(np.log(1.25))
"""In place of `LARGE` for the ratio of two colours' gains: shading alone reaches 1.17."""
HUBER, ROUNDS = 1.5, 10
"""Residuals beyond so many standard deviations count linearly; rounds of reweighting."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Log gains of views."""

    log: NDArray[np.float64]
    """(views, 3) natural logarithm of each view's gain per colour; zero where it is not known."""
    sigma: NDArray[np.float64]
    """(views, 3) standard deviation; infinite where the gain is not known."""
    spread: NDArray[np.float64]
    """(views,) robust standard deviation of single points' log ratios about the gains; infinite where they are not known."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """(views,) whether the view was compared with others."""
        return np.isfinite(self.spread)

    @property
    def brighter(self) -> NDArray[np.bool_]:
        """(views,) whether the view's exposure differs from the median view's."""
        return self._differs(self.log.mean(-1), LARGE)

    @property
    def tinted(self) -> NDArray[np.bool_]:
        """(views,) whether the view's white balance differs from the median view's."""
        return self._differs(np.ptp(self.log, axis=-1), TINTED)

    def words(self) -> str:
        """What was found, in a sentence."""
        if not self.known.any():
            return "too few points were matched"
        gains = np.exp(self.log.mean(-1)[self.known])
        tinted = f", {int(self.tinted.sum())} have another white balance" if self.tinted.any() else ""
        count = f"{int(self.brighter.sum())} of {int(self.known.sum())} views are brighter or darker than the median view"
        return f"{count} ({gains.min():.2f} to {gains.max():.2f} times its light){tinted}"

    def _differs(self, size: NDArray[np.float64], least: float) -> NDArray[np.bool_]:
        size = np.abs(size)
        return self.known & (size > least) & (size > SURE * self.sigma.max(-1)) & (size > CLEAR * self.spread)


def measured(views: Sequence[View], matches: Matches) -> Gains:
    """Gains of all views, from matches between some of them."""
    index = {view.name: i for i, view in enumerate(views)}
    chosen = [index[view.name] for view in matches.views]
    found = gains_of(matches, np.stack([view.world_from_camera for view in matches.views]))
    log, sigma, spread = np.zeros((len(views), 3)), np.full((len(views), 3), np.inf), np.full(len(views), np.inf)
    log[chosen], sigma[chosen], spread[chosen] = found.log, found.sigma, found.spread
    return Gains(log, sigma, spread)


def gains_of(matches: Matches, world_from_camera: NDArray[np.float64]) -> Gains:
    """Gains from matches that the (views, 4, 4) poses explain."""
    pairs, ratios, sigmas, points = _ratios(matches, world_from_camera)
    count = len(matches.views)
    log, sigma, spread = np.zeros((count, 3)), np.full((count, 3), np.inf), np.full(count, np.inf)
    if not len(pairs):
        return Gains(log, sigma, spread)
    system = np.zeros((len(pairs), count))
    system[np.arange(len(pairs)), pairs[:, 0]], system[np.arange(len(pairs)), pairs[:, 1]] = 1.0, -1.0
    known = _largest_group(pairs, count)
    inside = known[pairs[:, 0]]
    for colour in range(3):
        log[:, colour], sigma[:, colour] = _solved(system[inside], ratios[inside, colour], sigmas[inside, colour])
        log[:, colour] -= np.median(log[known, colour])
    sigma[~known], log[~known] = np.inf, 0.0
    for view in np.flatnonzero(known):
        spread[view] = _own_spread(view, pairs, points, log)
    return Gains(log, sigma, spread)


def _ratios(
    matches: Matches, matrices: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], list[NDArray[np.float64]]]:
    """Pairs (n, 2), their median log ratios (n, 3), the standard deviations of these, and the ratios of their points."""
    pairs, ratios, sigmas, points = [], [], [], []
    for pair in matches.pairs:
        i, j, index = pair
        good = index[explained(matches, pair, matrices)]
        light = np.stack([matches.features[i].colour[good[:, 0]], matches.features[j].colour[good[:, 1]]])
        lit = np.all((light > DARK) & (light < BRIGHT), axis=(0, 2))
        if lit.sum() < FEWEST:
            continue
        of_points = np.log(light[0, lit].astype(np.float64) / light[1, lit])
        middle = np.median(of_points, 0)
        deviation = 1.4826 * np.median(np.abs(of_points - middle), 0)
        pairs.append((i, j))
        ratios.append(middle)
        sigmas.append(1.2533 * np.maximum(deviation, 0.01) / np.sqrt(lit.sum()))  # of a median
        points.append(of_points)
    shape = (len(pairs), 3)
    return np.array(pairs, np.int64).reshape(-1, 2), np.reshape(ratios, shape), np.reshape(sigmas, shape), points


def _largest_group(pairs: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """(count,) which views are in the largest group that pairs connect."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1]
    return group == np.bincount(group).argmax()


def _solved(
    system: NDArray[np.float64], ratios: NDArray[np.float64], sigma: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(views,) log gains with zero mean and their standard deviations, scaled to the residuals that are left."""
    weight = np.ones(len(ratios))
    values, spread = np.zeros(system.shape[1]), 1.0
    for _ in range(ROUNDS):
        rows = system * (np.sqrt(weight) / sigma)[:, None]
        values = np.linalg.lstsq(rows, ratios * np.sqrt(weight) / sigma, rcond=1e-9)[0]
        size = np.abs(system @ values - ratios) / sigma
        spread = max(1.4826 * float(np.median(size)), 1.0)
        weight = np.minimum(1, HUBER * spread / np.maximum(size, 1e-12))
    rows = system * (np.sqrt(weight) / sigma)[:, None]
    return values, spread * np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows, rcond=1e-9, hermitian=True)))


def _own_spread(
    view: int, pairs: NDArray[np.int64], points: list[NDArray[np.float64]], log: NDArray[np.float64]
) -> float:
    """Robust standard deviation of the log ratios of one view's points about its gains."""
    left = [points[k] - (log[i] - log[j]) for k, (i, j) in enumerate(pairs) if view in (i, j)]
    return 1.4826 * float(np.median(np.abs(np.concatenate(left))))
