"""The tests of differences against scipy's, and their rate of false alarms against what they promise."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from koala3d.reconstruct.bench import compare
from koala3d.reconstruct.bench.compare import EVERYWHERE, paired, welch


def test_welch_is_scipys() -> None:
    a, b = np.array([25.0, 25.3, 24.8]), np.array([26.0, 25.9])
    found = welch("place", "psnr", a, b)
    expected = stats.ttest_ind(b, a, equal_var=False)
    interval = expected.confidence_interval(0.95)
    np.testing.assert_allclose([found.p, found.low, found.high], [expected.pvalue, interval.low, interval.high], rtol=1e-9)
    assert found.verdict == "better"


def test_paired_is_scipys() -> None:
    pairs = np.array([[25.0, 25.4], [30.0, 30.3], [20.0, 20.6]])
    expected = stats.ttest_rel(pairs[:, 1], pairs[:, 0])
    found = paired("normal_mae_deg", pairs)
    np.testing.assert_allclose(found.p, expected.pvalue, rtol=1e-9)
    assert found.verdict == "worse"  # degrees of error that rose


def test_false_alarms_are_as_rare_as_promised() -> None:
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(2000, 2, 3))
    alarms = np.mean([welch("", "psnr", a, b).verdict != "noise" for a, b in draws])
    assert 0.02 < alarms < 0.065  # 5 %; with three seeds Welch's test is somewhat stricter; 2000 draws give +-0.5 %


def test_one_seed_cannot_be_tested_and_equal_bits_are_equal() -> None:
    assert welch("", "psnr", np.array([25.0]), np.array([26.0, 26.1])).verdict == "unknown"
    assert welch("", "psnr", np.array([25.0, 25.0]), np.array([25.0, 25.0])).verdict == "noise"


def test_only_what_both_have_is_compared(make_row: Callable) -> None:
    before = [make_row(seed=float(seed), psnr=25 + 0.1 * seed) for seed in range(3)]
    before += [make_row(seed=float(seed), scene="teapot", psnr=30 + 0.1 * seed) for seed in range(3)]
    after = [make_row(seed=float(seed), psnr=26 + 0.1 * seed) for seed in range(3)] + [make_row(kind="cost", psnr=99.0)]
    found = compare.compare(before, after, ("psnr", "chamfer_mm"))
    assert [(one.place, one.figure) for one in found] == [("chrome_ball, surfnerf fast, 15 s", "psnr")]
    assert found[0].change == pytest.approx(1.0)
    told = compare.summary(found)
    assert told["tested"] == 1 and told["expected_false_alarms"] == 0.05
    assert "better" in compare.text(found) and "1 of 1" in compare.text(found)


def test_small_changes_everywhere_are_seen_over_all_places(make_row: Callable) -> None:
    rng = np.random.default_rng(1)
    scenes = [f"scene{index}" for index in range(8)]
    rows = lambda gain: [make_row(scene=scene, seed=float(seed), psnr=25 + gain + rng.normal(0, 0.3))  # noqa: E731
                         for scene in scenes for seed in range(2)]  # fmt: skip
    found = compare.compare(rows(0.0), rows(0.5), ("psnr",))
    assert found[0].place == EVERYWHERE and found[0].verdict == "better" and len(found) == 9
