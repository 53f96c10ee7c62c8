"""Exposure and white balance of each view, from the colours of points that several views see.

Poses and matches decide which points two views share; the median ratio of their colours is one measurement per pair and channel.
Highlights, which move over the surface, disturb single points and are outvoted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.relative import robust_median, values_of_views
from koala3d.datasets.structure.triangulate import explained

DARK, CLIPPED = 0.01, 0.9
"""Linear light outside which a channel tells nothing of the exposure: noise and black level, or saturation."""
FEWEST = 8
"""Smallest number of shared points for a pair of views to count."""


@dataclass(frozen=True, eq=False)
class ExposureGains:
    """Linear light of each view relative to the median view, for the same points."""

    names: tuple[str, ...]
    """Names of the views."""
    log_gains: NDArray[np.float64]
    """(views, 3) natural logarithm of the gain of red, green and blue; NaN where a view shares too few points."""
    std: NDArray[np.float64]
    """(views, 3) standard deviation of `log_gains`; contradictions between pairs, as of a shiny object, are included."""
    points: NDArray[np.int64]
    """(views,) number of matched points behind each view's gain; a point counts once per pair."""

    @property
    def gains(self) -> NDArray[np.float64]:
        """(views,) gain of each view, the geometric mean of its channels."""
        return np.exp(self.log_gains.mean(1))

    @property
    def white_balance(self) -> NDArray[np.float64]:
        """(views, 3) gain of each channel divided by the view's gain."""
        return np.exp(self.log_gains - self.log_gains.mean(1, keepdims=True))


def exposure_gains(matches: Matches, world_from_camera: NDArray[np.float64]) -> ExposureGains:
    """Gains of the views of `matches` with (views, 4, 4) poses."""
    count = len(matches.views)
    measured: list[list[tuple[tuple[int, int], float, float]]] = [[], [], []]
    points = np.zeros(count, np.int64)
    for pair in matches.pairs:
        i, j, index = pair
        good = index[explained(matches, pair, world_from_camera)]
        first, second = matches.features[i].colours[good[:, 0]], matches.features[j].colours[good[:, 1]]
        usable = (np.minimum(first, second) > DARK) & (np.maximum(first, second).max(1, keepdims=True) < CLIPPED)
        points[[i, j]] += int(usable.all(1).sum())
        for channel, rows in enumerate(usable.T):
            if rows.sum() >= FEWEST:
                middle, std = robust_median(np.log(first[rows, channel] / second[rows, channel])[:, None])
                measured[channel].append(((i, j), float(middle[0]), float(std[0])))
    log_gains, std = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    for channel, rows in enumerate(measured):
        if rows:
            pairs, differences, deviations = zip(*rows, strict=True)
            found = values_of_views(count, pairs, np.array(differences), np.array(deviations))
            log_gains[:, channel], std[:, channel] = found
    return ExposureGains(tuple(view.name for view in matches.views), log_gains, std, points)
