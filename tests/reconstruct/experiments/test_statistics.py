import numpy as np
import pytest
from scipy import stats

from koala3d.reconstruct.experiments.statistics import Sample, paired, welch


def test_welch_of_summaries_is_scipys_of_the_values() -> None:
    a, b = np.array([25.0, 25.3, 24.8]), np.array([26.0, 25.9])
    change = welch(Sample.of(a), Sample.of(b))
    expected = stats.ttest_ind(b, a, equal_var=False)
    interval = expected.confidence_interval(0.95)
    np.testing.assert_allclose([change.p, change.low, change.high], [expected.pvalue, interval.low, interval.high], rtol=1e-9)


def test_one_seed_leaves_the_interval_unknown() -> None:
    one = Sample.of([25.0])
    assert one.mean == 25.0 and np.isnan(one.deviation)
    change = welch(one, Sample.of([26.0, 26.2]))
    assert change.value == pytest.approx(1.1) and np.isnan([change.low, change.high, change.p]).all()


def test_paired_is_scipys() -> None:
    pairs = np.array([[25.0, 25.4], [30.0, 30.3], [20.0, 20.6]])
    np.testing.assert_allclose(paired(pairs).p, stats.ttest_rel(pairs[:, 1], pairs[:, 0]).pvalue, rtol=1e-9)


def test_false_alarms_are_as_rare_as_promised() -> None:
    draws = np.random.default_rng(0).normal(size=(2000, 2, 3))
    alarms = np.mean([welch(Sample.of(a), Sample.of(b)).p < 0.05 for a, b in draws])
    assert 0.02 < alarms < 0.065  # 5 %; with three seeds Welch's test is somewhat stricter; 2000 draws give +-0.5 %


def test_equal_bits_are_equal() -> None:
    same = Sample.of([25.0, 25.0])
    assert welch(same, same).p == 1.0
