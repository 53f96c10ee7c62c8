import numpy as np
import pytest

from koala3d.datasets.structure.relative import robust_median, values_of_views

PAIRS = [(i, j) for i in range(8) for j in range(i + 1, 8) if j - i < 4]


def test_values_are_found_from_their_differences() -> None:
    true = np.random.default_rng(0).normal(0, 1, 8)
    differences = np.array([true[i] - true[j] for i, j in PAIRS])
    values, std = values_of_views(8, PAIRS, differences, np.full(len(PAIRS), 0.01))
    assert np.abs(values - (true - np.median(true))).max() < 1e-8  # exact measurements
    assert (std > 0).all() and (std < 0.02).all()


def test_one_wrong_pair_is_outvoted() -> None:
    true = np.random.default_rng(1).normal(0, 1, 8)
    differences = np.array([true[i] - true[j] for i, j in PAIRS])
    differences[4] += 5.0
    values, _ = values_of_views(8, PAIRS, differences, np.full(len(PAIRS), 0.01))
    assert np.abs(values - (true - np.median(true))).max() < 0.05  # least squares without weights errs by more than 1


def test_deviations_hold_what_pairs_contradict() -> None:
    """Claimed 0.01, true 0.2: values over their deviations must have a variance of about one."""
    random = np.random.default_rng(2)
    scaled = []
    for _ in range(40):
        differences = random.normal(0, 0.2, len(PAIRS))
        values, std = values_of_views(8, PAIRS, differences, np.full(len(PAIRS), 0.01))
        scaled.append((values - values.mean()) / std)
    assert 0.6 < np.std(scaled) < 1.8  # 320 values of eight dependent views each


def test_views_without_a_chain_to_the_others_are_not_known() -> None:
    values, std = values_of_views(6, [(0, 1), (1, 2), (4, 5)], np.array([1.0, 1.0, 7.0]), np.full(3, 0.1))
    assert np.isnan(values[3:]).all() and np.isnan(std[3:]).all()
    assert values[:3] == pytest.approx([1, 0, -1], abs=1e-8)
    assert np.isnan(values_of_views(3, [], np.zeros(0), np.zeros(0))[0]).all()


def test_the_median_has_the_deviation_of_a_median() -> None:
    draws = np.random.default_rng(3).normal(5, 2, (400, 200))
    middle, std = robust_median(draws)
    assert middle.mean() == pytest.approx(5, abs=0.05)
    assert std.mean() == pytest.approx(middle.std(), rel=0.15)  # 200 draws of a deviation: 5 %
