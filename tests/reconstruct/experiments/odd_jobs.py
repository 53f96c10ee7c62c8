"""Jobs without a training, which end in various ways; workers of a cluster import them."""

import json
import os
import signal
from dataclasses import replace
from pathlib import Path

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.experiments.jobs import Job
from koala3d.reconstruct.experiments.results import Result


class Written(Job):
    """Writes a run as training and evaluation do."""

    def run(self) -> None:
        write_run(self)


class Dying(Job):
    """Takes its worker with it, with a last word past Python's own streams."""

    def run(self) -> None:
        os.write(2, b"this does not fit\n")
        os.kill(os.getpid(), signal.SIGKILL)


class Astray(Job):
    """Writes its run outside the sweep, as on a node with a disk of its own."""

    def run(self) -> None:
        write_run(replace(self, path=self.path.parents[4] / "another_disk"))


class Refused(Job):
    """Meets an error of ours."""

    def run(self) -> None:
        raise UsageError("holds no pictures", where=self.recipe.scene, remedy="choose another")


class Faulty(Job):
    """Meets an error that nobody expected, of two lines."""

    def run(self) -> None:
        raise ValueError("no such axis\nin this array")


def write_run(job: Job, psnr: float = 20.0) -> None:
    """Write the files of a run, and its result."""
    path, recipe = job.path, job.recipe
    path.mkdir(parents=True)
    normalisation = {"centre": [0.0, 0.0, 0.0], "scale": 1.0, "bounded": True, "near": 0.1, "far": 2.0}
    run = {"format": "koala-run", "version": 1, "scene": recipe.scene, "scene_name": Path(recipe.scene).name,
           "budget_s": recipe.budget_s, "config": recipe.config(job.changes).model_dump(mode="json"),
           "facts": {"normalisation": normalisation}}  # fmt: skip
    (path / "run.json").write_text(json.dumps(run))
    mean = {"psnr": psnr, "normal_mae_alpha_acc_deg": 50.0 - psnr}
    metrics = {"format": "koala-metrics", "version": 1, "mean": mean, "per_view": []}
    (path / "metrics.json").write_text(json.dumps(metrics))
    found = Result.of_run(
        path, setting=job.setting, work={"steps": 100.0}, machine={"machine": "a processor", "cores": 2, "load": 0.5}
    )
    job.result.write_text(json.dumps(found.content()))
