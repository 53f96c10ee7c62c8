import json
import subprocess
import sys

import pytest

from tests.bench import calibrate
from tests.bench.rehearsals import Rehearsal, Step


def step(views: int, error: float, stated: float) -> Step:
    return Step(views, 2.0 * views, (stated, stated / 4), (error, error / 4), (error, error / 4))


def four() -> list[Rehearsal]:
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
    found = calibrate.summary(four(), (0.1, 0.1))
    # 0.5 / n <= 1 / 25 from n = 13 on
    assert found["views_to_expected"] == 13 and found["views_share"] == pytest.approx(13 / 25)
    assert found["seconds_share"] == pytest.approx(13 / 25) and found["fixed_seconds"] == 50
    assert found["sixty_percent"] == 15 and found["better_at_sixty_percent"] == [3, 4]
    assert found["stopped"] == 4 and found["above_stated"] == 1 and found["above_wanted"] == 1
    assert "| 13 (52%) |" in calibrate.describe(found)


def test_an_error_that_rises_again_does_not_count():
    steps = [step(5, 0.1, 1), step(6, 0.3, 1), step(7, 0.1, 1)]
    assert calibrate.as_good(steps, (0.2, 0.2)) is steps[2]
    assert calibrate.as_good(steps[:2], (0.2, 0.2)) is None


def test_a_report_is_written(tmp_path):
    calibrate.write(tmp_path / "bench", four(), (0.1, 0.1))
    assert "| 13 (52%) |" in (tmp_path / "bench" / "bench.md").read_text()
    assert (tmp_path / "bench" / "bench.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_chosen_views_beat_the_fixed_ones(tmp_path):
    command = [
        sys.executable,
        "-m",
        "tests.bench.calibrate",
        str(tmp_path / "bench"),
        "--rigs",
        "6",
        "--json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["views_share"] <= 0.6 and found["above_wanted"] <= 1 and found["stopped"] == 6
