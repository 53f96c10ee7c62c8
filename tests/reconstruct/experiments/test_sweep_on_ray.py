"""Sweeps on a real Ray cluster on this machine: a worker is killed, a node is lost, and jobs fail in every way."""

import io
import json
import os
import platform
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, redirect_stderr, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala
from koala3d.datasets.scene import Scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.cli import main
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.experiments import sweep
from koala3d.reconstruct.experiments.jobs import Job
from koala3d.reconstruct.output.evaluate import METRICS
from koala3d.reconstruct.run import CHECKPOINTS
from koala3d.reconstruct.training.pace.pause import PauseRequests
from tests.reconstruct.cluster import NODE, on_ray, workers
from tests.reconstruct.cluster import cluster as cluster
from tests.reconstruct.experiments.odd_jobs import Astray, Dying, Faulty, Refused, Written
from tests.small import SET

pytestmark = pytest.mark.filterwarnings("ignore:os.fork")  # so Ray starts a node; the child becomes its program at once
STEPS = 96
SETTINGS = [*SET, f"train.steps={STEPS}", "train.checkpoint_s=0.001"]
"""There is a checkpoint after every chunk, which has 16 steps."""
SHARE = 0.1
"""Of the time that a training may use until it is struck, so that nobody is too late for that."""
PATIENCE_S = 120.0


def parent(process: int) -> int:
    (number,) = re.findall(r"^PPid:\s*(\d+)", Path(f"/proc/{process}/status").read_text(), re.MULTILINE)
    return int(number)


def in_training(jobs: Sequence[Job], raylets: Collection[int]) -> tuple[Job, int, int]:
    """A job between its first checkpoint and its last, the process that runs it, and that one's parent, one of `raylets`."""
    pages = [PauseRequests(job.path) for job in jobs]
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        for job, page in zip(jobs, pages, strict=True):
            page.request(SHARE)
            saved = checkpoint.steps(job.path / CHECKPOINTS)
            if saved and int(saved[-1].name) < STEPS and (raylet := parent(worker := workers(job.log)[-1])) in raylets:
                return job, worker, raylet
        time.sleep(0.01)
    raise AssertionError("nothing trains there")


def struck(cluster: Any, lost: Any, jobs: Sequence[Job]) -> dict[str, Job]:
    """Kill a worker of the first node and take the node `lost` away, each in the middle of a training; the jobs by the reason."""
    nodes = {node.all_processes["raylet"][0].process.pid: node for node in (cluster.head_node, lost)}
    hit: dict[str, Job] = {}
    while nodes:
        job, worker, raylet = in_training([job for job in jobs if job not in hit.values()], nodes)
        if nodes.pop(raylet) is lost:
            os.kill(worker, signal.SIGSTOP)  # a machine that fails computes no more
            cluster.remove_node(lost)
            hit["its node is gone"] = job
        else:
            hit["it crashed or was killed"] = job
        with suppress(ProcessLookupError):
            os.kill(worker, signal.SIGKILL)
    return hit


def timeless(value: Any) -> Any:
    """Content of a JSON file without times."""
    if isinstance(value, dict):
        return {key: timeless(inner) for key, inner in value.items() if key not in ("seconds", "compilation_s")}
    return [timeless(inner) for inner in value] if isinstance(value, list) else value


def results(out: Path) -> list[Any]:
    """The table of a sweep and the metrics of its runs."""
    return [(out / "table.md").read_text(), *(timeless(json.loads(path.read_text())) for path in sorted(out.rglob(METRICS)))]


@pytest.mark.timeout(600)  # nothing compiled yet, on a busy machine
def test_a_killed_worker_and_a_lost_node_change_no_result(
    ball_scene: tuple[Scene, Path],
    cluster: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run_inside: Callable[..., "subprocess.CompletedProcess[str]"],
) -> None:
    koala.save(ball_scene[0], tmp_path / "ball")  # without the true mesh: comparing it takes longer than the training
    monkeypatch.chdir(tmp_path)  # workers have another working directory
    request = ["--scene", "ball", "--model", "mipnerf", "--json", *(word for seed in range(4) for word in ("--seed", seed))]
    command = [main, "reconstruct", "sweep", *request, *(word for setting in SETTINGS for word in ("--set", setting))]
    alone = run_inside(*command, "--out", "alone")
    jobs = sweep.plan(["ball"], ["mipnerf"], "fast", SETTINGS, Path("spread"), seeds=range(4))
    lost = cluster.add_node(**NODE)
    with ThreadPoolExecutor(1) as thread:
        striking = thread.submit(struck, cluster, lost, jobs)
        spread = run_inside(*command, "--out", "spread", "--ray", "--address", cluster.address)
        hit = striking.result()
    assert results(tmp_path / "spread") == results(tmp_path / "alone")
    assert json.loads(spread.stdout.replace("spread", "alone")) == json.loads(alone.stdout)
    losses = sorted(line for line in spread.stderr.splitlines() if "lost its worker" in line)
    assert losses == sorted(f"{job.path}: lost its worker ({why}), 1 of 3: goes on elsewhere" for why, job in hit.items())
    for job in hit.values():
        assert len(set(workers(job.log))) == 2
        (step,) = re.findall(r": goes on from step (\d+)$", job.log.read_text(), re.MULTILINE)
        assert 0 < int(step) < STEPS


@dataclass(frozen=True)
class Failed:
    """A sweep of whose jobs only one ends well."""

    jobs: dict[str, Job]
    """By their kinds."""
    said: dict[str, list[str]]
    """The lines about each."""
    table: str


@pytest.fixture(scope="module")
def failed(ball_scene: tuple[Scene, Path], cluster: Any, tmp_path_factory: pytest.TempPathFactory) -> Failed:
    """A sweep of jobs of every kind; a plain `Job` has a path that leads elsewhere on its node."""
    out = tmp_path_factory.mktemp("failed")
    absent: Any = ModuleType("absent")
    absent.Unknown = type("Unknown", (Job,), {"__module__": "absent"})
    kinds = (Written, Astray, Refused, Faulty, Job, absent.Unknown, Dying)
    planned = sweep.plan([str(ball_scene[1])], ["zipnerf"], "fast", [], out, seeds=range(len(kinds)))
    jobs = {kind.__name__: kind(job.path, job.recipe, job.setting, job.changes) for kind, job in zip(kinds, planned, strict=True)}
    jobs["Job"] = replace(jobs["Job"], path=Path("/proc/self/cwd") / jobs["Job"].path.relative_to(out))
    with chdir(out), redirect_stderr(io.StringIO()) as stderr, mock.patch.dict(sys.modules, {"absent": absent}):
        with pytest.raises(ReconstructError, match="6 of 7 runs failed"):
            sweep.run([*jobs.values()], out, partial(on_ray.run_all, address=None))
    lines = stderr.getvalue().splitlines()
    said = {name: [line for line in lines if f"{job.path.name}: " in line] for name, job in jobs.items()}
    return Failed(jobs, said, (out / "table.md").read_text())


def test_a_job_that_kills_its_workers_is_given_up_and_the_others_finish(failed: Failed) -> None:
    job = failed.jobs["Dying"]
    goes_on = [f"{job.path}: lost its worker (it crashed or was killed), {n} of 3: goes on elsewhere" for n in (1, 2)]
    gives_up = f"ball/zipnerf/base/seed_6: lost its worker 3 times; {job.log} ends with: this does not fit"
    assert failed.said["Dying"] == [*goes_on, gives_up]
    assert len(set(workers(job.log))) == 3
    assert failed.said["Written"] == [] and "| ball | zipnerf | 20.00 |" in failed.table


def test_a_folder_that_is_not_shared_is_named_with_the_node(failed: Failed) -> None:
    node, remedy = platform.node(), "is --out on a disk that all nodes share?"
    astray, unseen = failed.jobs["Astray"].result, failed.jobs["Job"].log
    assert failed.said["Astray"] == [f"ball/zipnerf/base/seed_1: ended on {node} and left no {astray}; {remedy}"]
    assert failed.said["Job"] == [f"ball/zipnerf/base/seed_4: {node} does not see {unseen}; {remedy}"]


def test_errors_read_as_without_ray(failed: Failed) -> None:
    assert failed.said["Refused"] == [f"ball/zipnerf/base/seed_2: {failed.jobs['Refused'].attempt()}"]
    log = failed.jobs["Faulty"].log
    message = f"unexpected ValueError: no such axis in this array; {log} has its traceback"
    assert failed.said["Faulty"] == [f"ball/zipnerf/base/seed_3: {message}"]
    assert "Traceback" in log.read_text() and "odd_jobs.py" in log.read_text()
    assert len(workers(failed.jobs["Refused"].log)) == len(workers(failed.jobs["Faulty"].log)) == 1


def test_a_worker_that_cannot_import_a_job_is_no_lost_worker(failed: Failed) -> None:
    why = "ModuleNotFoundError: No module named 'absent'"
    assert failed.said["Unknown"] == [
        f"ball/zipnerf/base/seed_5: Ray cannot run it ({why}); do all nodes have this version of Koala?"
    ]


@pytest.mark.parametrize(("address", "why"), [("127.0.0.1:1", "Connection refused"), ("nowhere", "Invalid address format")])
def test_a_cluster_that_is_not_there_is_named(address: str, why: str) -> None:
    with pytest.raises(UsageError, match=rf"^{address}: cannot join the Ray cluster \(.*{why}.*ray start --head"):
        next(on_ray.run_all([], address))
