"""What ablations and sweeps have in common: trainings that are resumed, in a folder that is extended."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from koala3d.datasets.core import files
from koala3d.datasets.core.console import hint, progress
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.formats import find, load_scene
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.evaluate import METRICS, evaluate
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import CHECKPOINTS, RUN
from koala3d.reconstruct.training.loop import train

CELLS = "cells"  # folder of the trainings of a study with named cells
BASE = "base"  # cell without changes


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

    def content(self, *names: str) -> dict[str, Any]:
        """Some of the fields by name, for a file."""
        every = asdict(self) | {"overrides": list(self.overrides)}
        return {name: every[name] for name in names}


@dataclass(frozen=True)
class Job:
    """One training and its evaluation."""

    path: Path  # folder of the run
    recipe: Recipe
    changes: tuple[str, ...] = ()  # further overrides

    @property
    def done(self) -> bool:
        """Whether the run has been evaluated."""
        return (self.path / METRICS).is_file()

    def run(self) -> None:
        """Train and evaluate; resume an interrupted run."""
        if self.done:
            return
        config = self.recipe.config(self.changes)
        saved = checkpoint.steps(self.path / CHECKPOINTS) if (self.path / RUN).is_file() else []
        if resume := bool(saved):
            hint(f"{self.path}: goes on from step {int(saved[-1].name)}")
        elif self.path.exists():
            shutil.rmtree(self.path)  # interrupted before the first checkpoint
        scene = load_scene(self.recipe.scene, measure=not resume)
        train(scene, find(self.recipe.scene), config, self.path, budget_s=self.recipe.budget_s, resume=resume)
        evaluate(TrainedModel.open(self.path))

    def attempt(self) -> str:
        """Run; the error, or "". An error of one job does not concern the others of a study."""
        try:
            self.run()
        except (KoalaError, OSError) as error:
            return str(error)
        return ""


def run_all(jobs: Sequence[Job], title: str) -> None:
    """Run jobs one after the other."""
    with progress(title, len(jobs), "trainings") as bar:
        for job in jobs:
            bar.note(" ".join(job.path.parts[-2:]))
            job.run()
            bar.advance()


def chosen_seeds(base: Config, seeds: Sequence[int]) -> tuple[int, ...]:
    """The given seeds, or the configuration's own. Raises UsageError: a seed is given twice."""
    if len(set(seeds)) < len(seeds):
        raise UsageError("a seed is given twice", where="--seed", why=" ".join(map(str, seeds)), remedy="give each once")
    return tuple(seeds) or (base.train.seed,)


def scenes_by_name(scenes: Sequence[str]) -> dict[str, str]:
    """Paths of scenes by the names of their folders. Raises UsageError: a scene does not exist, or two have the same name."""
    places = [find(scene).resolve() for scene in scenes]
    if len({place.name for place in places}) < len(places):
        raise UsageError("two scenes have the same name", why=", ".join(place.name for place in places), remedy="rename a folder")
    return {place.name: str(place) for place in places}


def open_study(
    path: Path, *, kind: str, version: int, settings: Mapping[str, Any], members: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Start a study described by the file `path`, or check that an existing one has the same settings and extend it.

    Args:
        settings: values that never change, by key.
        members: collections, by key, to which entries may be added; an existing entry never changes.

    Returns:
        The content of the file.

    Raises UsageError: a setting differs, or the folder holds something else.
    """
    before: dict[str, Any] = {}
    if path.is_file():
        before = files.read_json(path, kind=kind, version=version)
        pairs = {key: (before.get(key), value) for key, value in settings.items()}
        for key, entries in members.items():
            known = before.get(key, {})
            pairs |= {f"{key}.{name}": (known.get(name, value), value) for name, value in entries.items()}
        for key, (old, new) in pairs.items():
            if old != new:
                why = f"{key} was {_shown(old)}, and is {_shown(new)} now"
                raise UsageError("was started with other settings", where=path.parent, why=why, remedy="choose another --out")
    else:
        files.refuse_existing(path.parent)
    merged = {key: before.get(key, {}) | dict(entries) for key, entries in members.items()}
    content = {"format": kind, "version": version, **settings, **merged}
    files.write_json(path, content)
    return content


def _shown(value: Any) -> str:
    """A setting as on the command line."""
    return " ".join(map(str, value or ["nothing"])) if isinstance(value, list) else "nothing" if value is None else str(value)
