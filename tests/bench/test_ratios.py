import numpy as np
import pytest

from tests.bench import ratios


def test_a_ratio_and_its_interval():
    rng = np.random.default_rng(0)
    first = rng.normal(size=400)
    assert ratios.of_errors(2 * first, first) == ratios.Ratio(2.0, 2.0, 2.0)  # trial by trial: no luck in it
    unrelated = ratios.of_errors(2 * rng.normal(size=400), first)
    assert unrelated.low < 2.0 < unrelated.high
    # the logarithm of each rms has deviation 1 / sqrt(2 n): 95 % within 1.96 * 2 / sqrt(2 n) = 14 %
    assert (unrelated.high - unrelated.low) / 2 == pytest.approx(2 * 1.96 * np.sqrt(2 / 800), rel=0.25)


def test_the_luck_of_the_draws_is_taken_out():
    """An estimator of 5 % more error than the bound, on draws that happen to be large."""
    rng = np.random.default_rng(1)
    efficient = rng.normal(size=(200, 3))
    errors = np.linalg.norm(efficient + np.sqrt(1.05**2 - 1) * rng.normal(size=(200, 3)), axis=1)
    efficient, bound = np.linalg.norm(efficient, axis=1), np.sqrt(3)
    found, plain = ratios.to_bound(errors, efficient, bound), ratios.of_errors(errors, np.full(200, bound))
    assert found.low < 1.05 < found.high
    assert found.high - found.low < 0.6 * (plain.high - plain.low)


def test_intervals_hold_the_truth():
    rng, held = np.random.default_rng(2), []
    for _ in range(100):
        efficient = rng.normal(size=200)
        found = ratios.to_bound(efficient + 0.3 * rng.normal(size=200), efficient, 1.0)
        held.append(found.low <= np.sqrt(1.09) <= found.high)
    assert np.mean(held) > 0.85  # 0.95 expected; of a hundred it scatters by 0.022


def test_a_method_that_missed_trials_is_beaten():
    assert ratios.of_errors(np.ones(3), np.ones(2)) == ratios.BETTER
