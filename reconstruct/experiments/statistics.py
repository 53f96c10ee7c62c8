"""Mean and spread of a figure over seeds, Welch's test (1947) of two such samples, and the paired t-test.

Welch's t-test allows for different spreads; it requires at least two seeds per sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Sample:
    """A figure of trainings that differ only in their seed."""

    mean: float
    deviation: float  # standard deviation over seeds; NaN for one seed
    count: int

    @classmethod
    def of(cls, values: Sequence[float] | np.ndarray) -> "Sample":
        """The sample of (n,) values, n > 0."""
        values = np.asarray(values, np.float64)
        return cls(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else np.nan, len(values))


@dataclass(frozen=True)
class Change:
    """Difference of two means."""

    value: float
    low: float  # ends of the confidence interval; NaN if unknown
    high: float
    p: float  # p-value; NaN if unknown


def welch(before: Sample, after: Sample) -> Change:
    """Difference between two samples, tested if both have two seeds."""
    value = after.mean - before.mean
    if min(before.count, after.count) < 2:
        return Change(value, np.nan, np.nan, np.nan)
    counts = np.array([before.count, after.count])
    shares = np.array([before.deviation, after.deviation]) ** 2 / counts
    freedom = shares.sum() ** 2 / (shares**2 / (counts - 1)).sum() if shares.sum() > 0 else 1.0
    return tested(value, float(np.sqrt(shares.sum())), float(freedom))


def paired(pairs: np.ndarray) -> Change:
    """Mean difference of (n, 2) pairs, n > 1, tested by the paired t-test."""
    sample = Sample.of(pairs[:, 1] - pairs[:, 0])
    return tested(sample.mean, float(sample.deviation / np.sqrt(sample.count)), sample.count - 1)


def tested(value: float, spread: float, freedom: float) -> Change:
    """A change with the standard error `spread`, tested by Student's t with `freedom` degrees of freedom."""
    from scipy.stats import t

    if spread == 0:  # equal values at every seed
        return Change(value, value, value, 1.0 if value == 0 else 0.0)
    reach = float(t.ppf(0.5 + CONFIDENCE / 2, freedom)) * spread
    return Change(value, value - reach, value + reach, float(2 * t.sf(abs(value) / spread, freedom)))
