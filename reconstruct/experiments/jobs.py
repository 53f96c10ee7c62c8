"""Trainings of a sweep: each is resumed, evaluated, and leaves its result beside its run."""

import resource
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from koala3d.datasets.core import files
from koala3d.datasets.core.console import hint
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.formats import find, load_scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.backend import configure_process
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.experiments import machine
from koala3d.reconstruct.experiments.results import Result
from koala3d.reconstruct.experiments.waiting import Needs
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.evaluate import evaluate
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import CHECKPOINTS, RUN
from koala3d.reconstruct.training.loop import train

BASE = "base"
"""Setting without changes."""


@dataclass(frozen=True)
class Recipe:
    """Scene, model and budget of a training."""

    scene: str  # path of the scene
    model: str
    preset: str
    overrides: tuple[str, ...] = ()
    budget_s: float | None = None  # seconds of training; None for the configuration's steps

    def config(self, changes: Sequence[str] = ()) -> Config:
        """The configuration, with further overrides. Raises UsageError for an unknown model, preset or setting."""
        return load_config(self.model, self.preset, [*self.overrides, *changes])


@dataclass(frozen=True)
class Job:
    """One training and its evaluation."""

    path: Path  # folder of the run
    recipe: Recipe
    setting: str = BASE
    changes: tuple[str, ...] = ()  # further overrides, the seed among them
    needs: ClassVar[Needs] = Needs()
    left_s: ClassVar[float] = 0.0

    @property
    def result(self) -> Path:
        """File with the result."""
        return self.path.with_name(f"{self.path.name}.json")

    @property
    def log(self) -> Path:
        """File with what its processes write to their terminals."""
        return self.path.with_name(f"{self.path.name}.log")

    @property
    def name(self) -> str:
        """SCENE/MODEL/SETTING/seed_N."""
        return "/".join(self.path.parts[-4:])

    @property
    def done(self) -> bool:
        """Whether there is a result."""
        return self.result.is_file()

    def run(self) -> None:
        """Train, evaluate and write the result; resume an interrupted run."""
        config, before = self.recipe.config(self.changes), machine.describe()
        saved = checkpoint.steps(self.path / CHECKPOINTS) if (self.path / RUN).is_file() else []
        if resume := bool(saved):
            hint(f"{self.path}: goes on from step {int(saved[-1].name)}")
        elif self.path.exists():
            shutil.rmtree(self.path)  # interrupted before the first checkpoint
        scene = load_scene(self.recipe.scene, measure=not resume)
        trained = train(scene, find(self.recipe.scene), config, self.path, budget_s=self.recipe.budget_s, resume=resume)
        model = TrainedModel.open(self.path)
        evaluate(model)
        found = Result.of_run(self.path, setting=self.setting, work=work(trained, model), machine=before)
        files.write_json(self.result, found.content())

    def attempt(self) -> str:
        """Run unless there is a result; the error, or "". An error of one job does not concern the others."""
        try:
            if not self.done:
                configure_process()
                self.run()
        except (KoalaError, OSError) as error:
            return str(error)
        return ""


def work(trained: dict[str, Any], model: TrainedModel) -> dict[str, float]:
    """Time, rates and memory of a training in this process, by the names of `results.WORK`."""
    sampler, seconds = model.model.sampler, max(trained["training_s"], 1e-9)
    per_second = trained["steps"] / seconds
    times = {name: float(trained[name]) for name in ("steps", "training_s", "preparation_s", "compilation_s")}
    rates = {"rays_per_s": per_second * sampler.rays_drawn, "samples_per_s": per_second * sampler.samples_drawn}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "linux" else 2**20)
    return {**times, **rates, "peak_memory_mb": peak}
