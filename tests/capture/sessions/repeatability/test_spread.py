"""The figures of repeatability on visits whose spread, drift and seeing are known."""

import numpy as np
import pytest

from koala3d.capture.sessions.repeatability.spread import UNITS, SeenVisit, repeatability
from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError

ARM = np.array([0.03, 0.03, 0.03, 5.0, 5.0, 5.0])  # [mm, mdeg]
CORNERS = 40


def seen(rng: np.random.Generator, visits: int, *, views: int = 5, arm=ARM, drift=(), seeing_px=0.0, warm=None, minutes=30.0):
    """Visits with errors of these deviations, a drift that is nearly over in the end, and corners that are seen off.

    A corner that is off by one pixel moves the pose by 0.01 mm and 3 mdeg / sqrt(corners).
    """
    found, share = [], lambda at: -np.expm1(-3 * at / (60 * minutes))
    bias = {str(corner): rng.normal(size=2) for corner in range(CORNERS)}  # a misprint: the same in every visit
    per_px = np.array([0.01] * 3 + [3.0] * 3) / UNITS
    for visit in range(visits):
        for view in range(views):
            at = 60 * minutes * (visit + view / views) / visits
            off = (
                arm * rng.normal(size=6) + np.array([*drift, 0, 0, 0])[:6] * share(at) if len(drift) else arm * rng.normal(size=6)
            )
            corners = seeing_px * rng.normal(size=(CORNERS, 2))
            off = off / UNITS + seeing_px * per_px * rng.normal(size=6)
            place = pose.rigid(np.eye(3), [0.4, 0.1 * view, 0.0])
            turned = pose.rigid(pose.from_rotation_vector(off[3:])[:3, :3] @ place[:3, :3], place[:3, 3] + off[:3])
            residuals = {name: vector + corner for (name, vector), corner in zip(bias.items(), corners, strict=True)}
            temperature = None if warm is None else 25 + warm * share(at)
            found.append(SeenVisit(view, visit, 1e9 + at, temperature, turned, np.diag(per_px**2), residuals))
    return found


def test_the_spread_is_that_of_the_arm_and_its_error_is_honest():
    """Over 60 sessions the error is within the standard error and two of them at least as often as that of a normal distribution.

    More often, because the standard error allows for corners whose errors are not independent; here they are.
    """
    sessions = [repeatability(seen(np.random.default_rng(seed), 8, seeing_px=1.5)) for seed in range(60)]
    off = np.array([(one.spread - ARM) / one.spread_error for one in sessions])
    assert abs(off.mean()) < 0.3  # 360 values: the mean of a normal distribution is within 0.16 with 99.7 %; s is biased slightly
    assert (np.abs(off) < 1).mean() > 0.68 and (np.abs(off) < 2).mean() > 0.95
    seeing = np.mean([one.seeing for one in sessions], axis=0)
    np.testing.assert_allclose(seeing, [0.015] * 3 + [4.5] * 3, rtol=0.05)


def test_without_subtracting_what_is_seen_off_the_spread_would_be_too_large():
    found = repeatability(seen(np.random.default_rng(0), 40, seeing_px=3.0))
    assert (np.abs(found.spread - ARM) < 3 * found.spread_error).all()
    assert (np.hypot(found.spread, found.seeing) > 1.2 * ARM).all()  # the premise


def test_an_arm_that_comes_back_exactly_has_no_spread_above_its_error():
    found = repeatability(seen(np.random.default_rng(3), 20, arm=0 * ARM, seeing_px=2.0))
    assert (found.spread < 3 * found.spread_error).all() and (found.spread < found.seeing).all()


def test_a_drift_is_told_from_the_spread():
    drift = np.array([0.2, -0.1, 0.05])
    found = repeatability(seen(np.random.default_rng(1), 30, drift=drift, warm=12.0))
    reached = drift * -np.expm1(-3 * (29 + 0.8) / 30)
    assert (np.abs(found.drift[:3] - reached) < 3 * found.drift_error[:3]).all() and (found.drift_error[:3] < 0.02).all()
    assert (np.abs(found.spread - ARM) < 3 * found.spread_error).all()
    assert found.warming == pytest.approx(12.0 * -np.expm1(-3 * 29.8 / 30), abs=0.5)
    assert found.per_degree is not None
    assert (np.abs(found.per_degree[:3] - drift / 12) < 3 * found.per_degree_error[:3]).all()
    assert found.minutes == pytest.approx(29.8)


def test_views_with_one_visit_are_left_out_and_too_few_visits_refused():
    every = seen(np.random.default_rng(2), 3)
    found = repeatability([one for one in every if one.view or not one.visit])
    assert set(found.views) == {1, 2, 3, 4} and len(found.deviations) == 12
    with pytest.raises(DatasetError, match="too few visits show the target"):
        repeatability([one for one in every if one.visit < 2])
