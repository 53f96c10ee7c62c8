import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from koala3d.capture.sessions.calibrate import bench, bench_report
from koala3d.capture.sessions.calibrate.bench import Rehearsal, Step


def step(views: int, error: float, stated: float) -> Step:
    return Step(views, 2.0 * views, (stated, stated / 4), (error, error / 4), (error, error / 4))


def rehearsals() -> list[Rehearsal]:
    """Four rigs: chosen views halve the error of as many fixed ones; the last one states less than its true error."""
    found = []
    for rig in range(4):
        fixed = [step(n, 1 / n, 2 / n) for n in (10, 25)]
        adaptive = [step(n, 0.5 / n, 1 / n) for n in range(5, 16)]
        if rig == 3:
            adaptive[-1] = Step(15, 30.0, (1 / 15, 1 / 60), (0.5, 0.001), adaptive[-1].spread)
        found.append(Rehearsal(rig, fixed, adaptive, "reached", 15))
    return found


def test_views_and_time_to_the_same_error():
    found = bench_report.summary(rehearsals(), (0.1, 0.1))
    # 0.5 / n <= 1 / 25 from n = 13 on
    assert found["views_to_expected"] == 13 and found["views_share"] == pytest.approx(13 / 25)
    assert found["seconds_share"] == pytest.approx(13 / 25) and found["fixed_seconds"] == 50
    assert found["sixty_percent"] == 15 and found["better_at_sixty_percent"] == [3, 4]
    assert found["stopped"] == 4 and found["above_stated"] == 1 and found["above_wanted"] == 1
    assert "| 13 (52%) |" in bench_report.describe(found)


def test_an_error_that_rises_again_does_not_count():
    steps = [step(5, 0.1, 1), step(6, 0.3, 1), step(7, 0.1, 1)]
    assert bench_report.as_good(steps, (0.2, 0.2)) is steps[2]
    assert bench_report.as_good(steps[:2], (0.2, 0.2)) is None


def test_report_has_every_step(tmp_path):
    found = rehearsals()
    summary = bench_report.write(tmp_path / "bench", found, (0.1, 0.1))
    rows = list(csv.DictReader((tmp_path / "bench" / "bench.csv").open()))
    assert len(rows) == 4 * (2 + 11) and tuple(rows[0]) == bench_report.COLUMNS
    assert float(rows[0]["true_mm"]) == 0.1 and rows[0]["session"] == "fixed"
    assert (tmp_path / "bench" / "bench.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(json.dumps(bench_report.plain({**summary, "views_share": np.inf})))["views_share"] is None


def test_flights_take_as_long_as_planned_ones(trajectory, carrier, arm):
    from koala3d.capture.planning import duration, plan

    planned = plan(trajectory, carrier)[:4]
    arm.present = planned[0].joints
    for view in planned:
        arm.take(view.joints)
    # the planner's estimate, and the settling of the first view's empty path is counted in both
    assert arm.seconds == pytest.approx(duration(trajectory, planned), rel=1e-6) and arm.taken == 4


@pytest.mark.slow
def test_chosen_views_beat_the_fixed_ones(tmp_path):
    command = [
        sys.executable,
        "-m",
        "koala3d.capture.cli",
        "bench-calibrate",
        "--rigs",
        "6",
        "--out",
        str(tmp_path / "bench"),
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["views_share"] <= 0.6 and found["above_wanted"] <= 1 and found["stopped"] == 6


def test_the_fixed_session_is_the_shipped_one(trajectory):
    assert len(trajectory.viewpoints()) == 25 and bench.FIXED == "calibration"
