import numpy as np
import pytest
from scipy import stats

from koala3d.reconstruct.studies.seeds import Sample, welch


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
