import numpy as np
import pytest

from calib import study
from calib.simulate import Pattern


def test_a_larger_board_is_known_to_be_better():
    variants = [study.Variant("small", study.KOALA), study.Variant("A3", study.A3)]
    small, large = study.run(2, 0, variants=variants)
    assert small.failures == large.failures == 0
    assert (np.median(large.stated, axis=0) < np.median(small.stated, axis=0)).all()
    assert small.refined.shape == small.park.shape == (2, 2)
    table = study.markdown([small, large])
    assert table.count("\n") == 3 and "A3" in table


def test_intrinsics_of_their_own_help():
    alone, along = study.run(1, 1, variants=[study.Variant("own", study.KOALA, separate=40), study.Variant("along", study.KOALA)])
    assert np.median(alone.stated[:, 1]) < np.median(along.stated[:, 1])


def test_failures_are_counted():
    straight = study.Variant("straight", study.KOALA, Pattern((0.0, 0.5), roll_deg=(0.0, 0.0)))
    (outcome,) = study.run(2, 0, variants=[straight])
    assert outcome.failures == 2 and "failed 2 times" in study.markdown([outcome])


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_koala_rig_reaches_its_aims():
    """0.03 mm / 0.005 deg repeatability, 0.1 px corners, 25 views, intrinsics estimated along; board of A3."""
    (outcome,) = study.run(60, 0, variants=[study.VARIANTS[6]])
    refined, _, _ = outcome.medians()
    assert outcome.failures == 0 and (refined <= study.AIM).all(), refined
