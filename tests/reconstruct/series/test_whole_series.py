"""Whole trainings in a series: Ctrl-C, a killed driver, and the same on a Ray cluster of this machine, whose worker is killed.

All in one file: what was trained once is compared with.
"""

import os
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir
from pathlib import Path
from typing import Any

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.scene import Scene
from koala3d.reconstruct.experiments.runner import run_all
from koala3d.reconstruct.experiments.waiting import Needs
from koala3d.reconstruct.series.file import read
from koala3d.reconstruct.series.run import Shelf, run
from koala3d.reconstruct.series.step import Step
from tests.moments import until
from tests.reconstruct.cluster import NODE, on_ray, workers
from tests.reconstruct.cluster import cluster as cluster
from tests.reconstruct.series.conftest import COMPILED_S, figures, in_training, words

pytestmark = pytest.mark.filterwarnings("ignore:os.fork")


@pytest.mark.timeout(1500)  # nothing compiled yet, on a busy machine
def test_ctrl_c_and_a_killed_driver_change_no_result(interrupted: Path) -> None:
    """Both scenes are the same, and only the training of the first was interrupted."""
    log = (interrupted / "one/steps/train.log").read_text()
    assert log.count("$ reconstruct train ") == 3 and log.count("--resume") == 2
    assert (interrupted / "two/steps/train.log").read_text().count("$ reconstruct train ") == 1
    found = figures(interrupted)
    assert found["one"] == found["two"] and found["one"][0] == "done" and found["one"][1]["psnr"] > 0
    assert ": 2 objects" in (interrupted / "index.html").read_text()


def test_what_is_done_is_not_done_again(interrupted: Path, two_balls: Path) -> None:
    """Nor is a process started for it: the test would take minutes."""
    before = {path: path.stat().st_mtime_ns for path in interrupted.rglob("steps/*")}
    run(Shelf(read(two_balls), interrupted), run_all)
    assert {path: path.stat().st_mtime_ns for path in interrupted.rglob("steps/*")} == before and len(before) == 8


def strike(out: Path) -> None:
    """Kill the worker of the first training in its midst."""
    until(lambda: in_training(out / "one/run"), "the first checkpoint", COMPILED_S)
    os.kill(workers(out / "one/steps/train.log")[-1], signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_results_on_a_cluster_are_those_without_one(cluster: Any, two_balls: Path, interrupted: Path) -> None:
    """Two nodes; the worker of one training is killed, with the command that it runs, and the training goes on elsewhere."""
    cluster.add_node(**NODE)
    out = two_balls.parent / "spread"
    with ThreadPoolExecutor(1) as thread:
        struck = thread.submit(strike, out)
        command = words(two_balls, out, "--ray", "--address", cluster.address)
        done = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
        struck.result()
    assert done.returncode == 0, done.stderr
    assert figures(out) == figures(interrupted)
    assert "one/steps/train: lost its worker (it crashed or was killed), 1 of 3: goes on elsewhere" in done.stderr
    assert (out / "one/steps/train.log").read_text().count("--resume") == 1


def test_the_most_work_left_goes_first_and_what_no_node_has_is_named(
    cluster: Any, ball_scene: tuple[Scene, Path], tmp_path: Path
) -> None:
    info = ("datasets", "info", str(ball_scene[1]))
    steps = [
        Step(tmp_path / f"{left:g}", "check", info, tmp_path, needs=Needs(cores=1 if left else 64), left_s=left)
        for left in (1.0, 0.0, 3.0, 2.0)
    ]
    ended = [(step.left_s, problem) for step, problem in on_ray.run_all([steps], cluster.address) if problem is not None]
    assert sorted(left for left, problem in ended if not problem) == [1.0, 2.0, 3.0]
    first = [step.result.stat().st_mtime_ns for step in sorted(steps, key=lambda one: -one.left_s)[:3]]
    assert first[-1] == max(first), "the least work last"
    assert ended[-1] == (0.0, "no node of the cluster has what it needs (64 cores, 0 GPUs)")


def test_a_folder_that_is_not_shared_is_named_before_anything_runs(cluster: Any, tmp_path: Path) -> None:
    """On each node /proc/self/cwd is another folder."""
    (tmp_path / "out").mkdir()
    with (
        chdir(tmp_path),
        pytest.raises(UsageError, match=r"^node \S+ \(\S+\): does not see /proc/self/cwd/out; put it on a disk"),
    ):
        next(on_ray.run_all([[]], cluster.address, shared=[Path("/proc/self/cwd/out")]))
    assert not list((tmp_path / "out").iterdir())
