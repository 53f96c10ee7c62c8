"""What another seed would have made of a figure: its mean and spread over seeds, and Welch's test (1947) of two such samples.

Welch's is the t-test of samples whose spreads may differ; it holds for as few as two seeds a side, and needs those.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


def seed_folder(seed: int) -> str:
    """Name of the folder of a seed's run, among those of its training."""
    return f"seed_{seed}"


@dataclass(frozen=True)
class Sample:
    """One figure of trainings that differ in nothing but their seed."""

    mean: float
    deviation: float
    """Standard deviation of a single seed; NaN where there is one only."""
    count: int

    @classmethod
    def of(cls, values: Sequence[float] | np.ndarray) -> "Sample":
        """The sample of (n,) values, n > 0."""
        values = np.asarray(values, np.float64)
        return cls(float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else np.nan, len(values))


@dataclass(frozen=True)
class Change:
    """How much higher one mean is than another."""

    value: float
    low: float
    """Ends of its interval of confidence; NaN where they cannot be known."""
    high: float
    p: float
    """Probability of at least such a change by chance alone; NaN where it cannot be known."""


def welch(before: Sample, after: Sample) -> Change:
    """From one sample to another; tested where both have two seeds."""
    value = after.mean - before.mean
    if min(before.count, after.count) < 2:
        return Change(value, np.nan, np.nan, np.nan)
    counts = np.array([before.count, after.count])
    shares = np.array([before.deviation, after.deviation]) ** 2 / counts
    freedom = shares.sum() ** 2 / (shares**2 / (counts - 1)).sum() if shares.sum() > 0 else 1.0
    return tested(value, float(np.sqrt(shares.sum())), float(freedom))


def tested(value: float, spread: float, freedom: float) -> Change:
    """A change whose standard error is `spread`, by Student's t with so many degrees of freedom."""
    from scipy.stats import t

    if spread == 0:  # the same bits at every seed
        return Change(value, value, value, 1.0 if value == 0 else 0.0)
    reach = float(t.ppf(0.5 + CONFIDENCE / 2, freedom)) * spread
    return Change(value, value - reach, value + reach, float(2 * t.sf(abs(value) / spread, freedom)))
