"""Whole trainings in a series: Ctrl-C, a killed driver, and the page at the end."""

import sys
from pathlib import Path

import pytest

from tests.reconstruct.series.conftest import figures

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")


@pytest.mark.timeout(1500)  # nothing compiled yet, on a busy machine
def test_ctrl_c_and_a_killed_driver_change_no_result(interrupted: Path) -> None:
    """Both scenes are the same, and only the training of the first was interrupted."""
    log = (interrupted / "one/steps/train.log").read_text()
    assert log.count("$ reconstruct train ") == 3 and log.count("--resume") == 2
    assert (interrupted / "two/steps/train.log").read_text().count("$ reconstruct train ") == 1
    found = figures(interrupted)
    assert found["one"] == found["two"] and found["one"][0] == "done" and found["one"][1]["psnr"] > 0
    page = (interrupted / "index.html").read_text()
    assert "2 objects" in page and f"{found['one'][1]['psnr']:.2f}"[:4] in page and "reconstruct series" not in page[:500]


def test_what_is_done_is_not_done_again(interrupted: Path, two_balls: Path) -> None:
    """Nor is a process started for it: the test would take minutes."""
    from koala3d.reconstruct.experiments.runner import run_all
    from koala3d.reconstruct.series.file import read
    from koala3d.reconstruct.series.run import Shelf, run

    before = {path: path.stat().st_mtime_ns for path in interrupted.rglob("steps/*")}
    run(Shelf(read(two_balls), interrupted), run_all)
    assert {path: path.stat().st_mtime_ns for path in interrupted.rglob("steps/*")} == before and len(before) == 8
