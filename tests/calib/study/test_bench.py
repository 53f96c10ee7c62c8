"""The benchmark itself, at few points; `calib bench` measures all of them."""

import csv

import numpy as np
import pytest

from koala3d.calib.handeye import closed_forms
from koala3d.calib.study import bench, bench_report, ratios

POINTS = [bench.Point(0.1, 0.03, 0.005, 8), bench.Point(1.0, 0.03, 0.005, 8), bench.Point(0.1, 0.03, 0.005, 10, bench.ESTIMATED)]


@pytest.fixture(scope="module")
def results():
    return list(bench.run(POINTS, 24, 1))


def test_refinement_is_at_or_below_the_best_closed_form_and_at_the_bound(results):
    for result in results:
        assert (
            max(r.value for r in result.against_best()) <= 1.02
        )  # the best of seven of 24 trials is lucky by a hundredth or two
        assert max(r.high for r in result.against_bound()) <= 1.10


def test_bound_is_what_the_efficient_estimator_shows(results):
    for result in results:
        drawn = result.methods[bench.DRAWN].rms
        # 24 trials of three numbers: 8.3 % one sigma, more where one direction dominates
        np.testing.assert_allclose(drawn, result.bound, rtol=0.35)


def test_perfect_measurements_are_exact():
    result = bench.measure(bench.Point(0.0, 0.0, 0.0, 6), 2, np.random.default_rng(0))
    assert result.methods[bench.REFINED].rms[0] < bench.EXACT[0] and result.against_best() == (ratios.EQUAL, ratios.EQUAL)


def test_same_seed_same_errors():
    first, second = (bench.measure(POINTS[0], 3, np.random.default_rng(7)) for _ in range(2))
    assert first.methods[bench.REFINED].translation_mm == second.methods[bench.REFINED].translation_mm


def test_failures_count_as_infinite():
    errors = bench.Errors()
    errors.add(np.eye(4), np.eye(4), 0.1)
    assert errors.rms == (0.0, 0.0)
    errors.failures += 1
    assert errors.rms == (np.inf, np.inf)


def test_a_refinement_that_failed_is_worse_than_anything():
    result = bench.measure(POINTS[0], 2, np.random.default_rng(0))
    result.methods[bench.REFINED].failures = 1
    assert result.against_best() == result.against_bound() == (ratios.WORSE, ratios.WORSE)


def drawn_result(rng, trials, sigma):
    """Seven closed forms as good as the refinement, each with a little luck of its own."""
    common = rng.normal(size=trials)
    methods = {name: bench.Errors() for name in (*closed_forms.METHODS, bench.REFINED, bench.DRAWN)}
    for name, errors in methods.items():
        own = 0.0 if name == bench.DRAWN else sigma
        errors.translation_mm = list(common + own * rng.normal(size=trials))
        errors.rotation_deg = errors.translation_mm
    return bench.Result(POINTS[0], methods, (1.0, 1.0))


def test_the_best_of_seven_is_chosen_without_luck():
    rng = np.random.default_rng(3)
    lucky, fair = [], []
    for _ in range(60):
        result = drawn_result(rng, 200, 0.1)
        best = result.methods[result.best[0]].translation_mm
        lucky.append(ratios.of_errors(result.methods[bench.REFINED].translation_mm, best).value)
        fair.append(result.against_best()[0].value)
    # one pair's ratio scatters by 0.1 * sqrt(2 / 200) = 0.010, the best of seven lies 1.35 deviations of its own out
    assert np.mean(lucky) > 1.006
    assert np.mean(fair) == pytest.approx(1.0, abs=4 * 0.010 / np.sqrt(60))


def test_where_the_arm_errs_in_place_alone_refinement_and_park_are_the_same_least_squares():
    """With exact corners the board's place is linear in both unknown translations: no method can do better."""
    methods = bench.measure(bench.Point(0.0, 1.0, 0.0, 8), 6, np.random.default_rng(5)).methods
    for other in ("park", "horaud", "shah", bench.DRAWN):
        # the arm's rotations are said to be right to 1e-4 degrees: a micrometre at half a metre, against a millimetre of noise
        np.testing.assert_allclose(methods[bench.REFINED].translation_mm, methods[other].translation_mm, atol=2e-3)


def test_close_calls_get_more_trials():
    arm_alone, corners_alone = bench.Point(0.0, 1.0, 0.0, 6), bench.Point(0.1, 0.0, 0.0, 6)
    assert bench.measure(arm_alone, 5, np.random.default_rng(0), more=2).trials == 10
    assert bench.measure(corners_alone, 5, np.random.default_rng(0), more=2).trials == 5
    assert bench.measure(bench.Point(0.0, 0.0, 0.0, 6), 2, np.random.default_rng(0), more=3).trials == 2  # all are exact


def test_full_grid_has_the_promised_extent():
    points = bench.full_grid()
    for name, low, high in (("sigma_px", 0, 1), ("arm_mm", 0, 1), ("arm_deg", 0, 0.1), ("views", 5, 50)):
        values = [getattr(p, name) for p in points]
        assert (min(values), max(values)) == (low, high)
    assert len(set(points)) == len(points)


def test_table_plot_and_summary_are_written(results, tmp_path):
    bench_report.write(tmp_path / "out", results)
    rows = list(csv.DictReader((tmp_path / "out" / "bench.csv").open()))
    assert len(rows) == len(POINTS) * 10 and {r["method"] for r in rows} >= {"park", "refinement", "bound"}
    assert (tmp_path / "out" / "bench.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "out" / "bench.md").read_text()
    assert "within 10% of the bound: 3 points" in text and text.count("\n| 0.1") == 2
    assert bench_report.summary(results)["points"] == 3
