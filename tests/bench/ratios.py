"""Ratios of rms errors over simulated trials, with intervals for the luck of the draws.

Two methods that met the same noise are compared trial by trial. Intervals are percentiles over trials drawn with replacement
(bootstrap; Efron & Tibshirani 1993, chapter 13), with the same draws for both methods.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from koala3d.calib.arrays import Array, Indices

DRAWS = 1000
LEVEL = (2.5, 97.5)  # percentiles of an interval that holds the truth in 95 of 100 cases


@dataclass(frozen=True)
class Ratio:
    """A ratio of rms errors and its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f}–{self.high:.2f})"


EQUAL, BETTER, WORSE = (Ratio(value, value, value) for value in (1.0, 0.0, np.inf))
"""Of two methods that are both exact; to a method that failed; of a method that failed."""


def of_errors(errors: ArrayLike, reference: ArrayLike) -> Ratio:
    """Rms of (n,) errors in units of the rms of (n,) others of the same trials; `BETTER` where some of those are missing."""
    if np.shape(errors) != np.shape(reference):
        return BETTER
    above, below = np.square(errors), np.square(reference)
    drawn = _draws(len(above))
    return _summed(np.sqrt(above.mean() / below.mean()), np.sqrt(above[drawn].mean(1) / below[drawn].mean(1)))


def to_bound(errors: ArrayLike, efficient: ArrayLike, bound: float) -> Ratio:
    """Rms of (n,) errors in units of a known bound, given (n,) errors of an efficient estimator on the same trials.

    With few trials the plain quotient depends more on the draws than on the method. The expected squared error of an efficient
    estimator is bound^2, so its error on the same noise shows how lucky the draws were; that is removed (a control variate;
    Hammersley & Handscomb 1964, 5.5):

        ratio^2 = (mean(errors^2) - mean(efficient^2) + bound^2) / bound^2.
    """
    excess = (np.square(errors) - np.square(efficient)) / bound**2
    drawn = _draws(len(excess))
    return _summed(np.sqrt(max(1 + excess.mean(), 0.0)), np.sqrt(np.maximum(1 + excess[drawn].mean(1), 0.0)))


def _draws(number: int) -> Indices:
    return np.random.default_rng(0).integers(number, size=(DRAWS, number))


def _summed(value: float, again: Array) -> Ratio:
    low, high = np.percentile(again, LEVEL)
    return Ratio(float(value), float(low), float(high))
