"""Jobs in processes of their own on this machine: what they write, and what they leave when they die."""

from collections.abc import Callable
from pathlib import Path

from koala3d.datasets.scene import Scene
from koala3d.reconstruct.experiments import runner, sweep
from koala3d.reconstruct.experiments.jobs import Job
from koala3d.reconstruct.experiments.results import WORK, Result
from tests.reconstruct.experiments.odd_jobs import Dying, Faulty, Written
from tests.small import SET


def test_a_job_that_dies_costs_itself_only(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    planned = sweep.plan([str(ball_scene[1])], ["zipnerf"], "fast", [], tmp_path, seeds=range(3))
    kinds = (Dying, Faulty, Written)
    jobs = [kind(job.path, job.recipe, job.setting, job.changes) for kind, job in zip(kinds, planned, strict=True)]
    died, faulty, fine = (problem for _, problem in runner.run_all([jobs]) if problem is not None)
    assert died == f"its process died; {jobs[0].log} ends with: this does not fit"
    assert faulty == f"unexpected ValueError: no such axis in this array; {jobs[1].log} has its traceback"
    assert "Traceback" in jobs[1].log.read_text() and fine == "" and jobs[2].done


def test_a_training_leaves_its_work_and_its_machine(
    ball_scene: tuple[Scene, Path], tmp_path: Path, without_mesh: Callable[..., None]
) -> None:
    overrides = [*SET, "train.steps=16"]
    (job,) = sweep.plan([str(ball_scene[1])], ["mipnerf"], "fast", overrides, tmp_path, settings=[])
    assert job.attempt() == ""
    found = Result.read(job.result)
    assert set(found.work) == set(WORK) and found.work["steps"] == 16 and found.work["rays_per_s"] > 0
    assert found.machine["cores"] >= 1 and found.evaluation["mean"]["psnr"] > 0 and found.origin.setting == "base"
    before = job.result.stat().st_mtime_ns
    assert job.attempt() == "" and job.result.stat().st_mtime_ns == before, "what is done is not done again"
    job.result.unlink()
    assert Job(job.path, job.recipe, job.setting, job.changes).attempt() == "" and job.done, "it is evaluated again"
