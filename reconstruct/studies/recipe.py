"""What the trainings of one table have in common: each is finished as far as it was not, and all as they were begun."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from datasets.core import files
from datasets.core.errors import UsageError
from datasets.formats import find, load_scene
from reconstruct.config import Config
from reconstruct.models import load_config
from reconstruct.output.evaluate import METRICS, evaluate
from reconstruct.output.trained_model import TrainedModel
from reconstruct.run import CHECKPOINTS, RUN
from reconstruct.training import checkpoint
from reconstruct.training.loop import train


@dataclass(frozen=True)
class Recipe:
    """Which model is trained on which scene, how and for how long."""

    scene: str
    """Path of the scene."""
    model: str
    preset: str
    overrides: tuple[str, ...] = ()
    budget_s: float | None = None
    """Seconds of training; None for the configuration's steps."""

    def config(self, changes: Sequence[str] = ()) -> Config:
        """The configuration, with further overrides. Raises UsageError for an unknown model, preset or setting."""
        return load_config(self.model, self.preset, [*self.overrides, *changes])

    def content(self, *names: str) -> dict[str, Any]:
        """Some of its parts by name, as files note them."""
        every = asdict(self) | {"overrides": list(self.overrides)}
        return {name: every[name] for name in names}


def chosen_seeds(base: Config, seeds: Sequence[int]) -> tuple[int, ...]:
    """The seeds asked for, else the one that a configuration has.

    Raises:
        UsageError: one is named twice.
    """
    if len(set(seeds)) < len(seeds):
        raise UsageError("a seed is named twice", where="--seed", why=" ".join(map(str, seeds)), remedy="name each once")
    return tuple(seeds) or (base.train.seed,)


def named(scenes: Sequence[str]) -> dict[str, str]:
    """Paths of scenes by the names of their folders, under which their trainings stand.

    Raises:
        UsageError: there is no such scene, or two have one name.
    """
    places = [find(scene).resolve() for scene in scenes]
    if len({place.name for place in places}) < len(places):
        raise UsageError("two scenes have one name", why=", ".join(place.name for place in places), remedy="rename a folder")
    return {place.name: str(place) for place in places}


def finish(path: Path, recipe: Recipe, changes: Sequence[str] = ()) -> None:
    """Train and measure one run, as far as that was not done yet; `path` is its folder."""
    if (path / METRICS).is_file():
        return
    config = recipe.config(changes)
    resume = (path / RUN).is_file() and bool(checkpoint.steps(path / CHECKPOINTS))
    if path.exists() and not resume:
        shutil.rmtree(path)  # broken off before its first checkpoint: nothing to go on with
    scene = load_scene(recipe.scene, measure=not resume)
    train(scene, find(recipe.scene), config, path, budget_s=recipe.budget_s, resume=resume)
    evaluate(TrainedModel.open(path))


def begin(path: Path, *, kind: str, version: int, settled: Mapping[str, Any], growing: Mapping[str, Mapping[str, Any]]) -> None:
    """Note in the file `path` what the trainings beside it have in common, or check that they are gone on with as they were begun.

    Args:
        settled: what never changes, by key.
        growing: collections to which may be added; an entry that is there already never changes.

    Raises:
        UsageError: something differs, so that unlike trainings would stand in one table; or the folder holds something else.
    """
    if path.is_file():
        before = files.read_json(path, kind=kind, version=version)
        known = {key: before.get(key, {}) for key in growing}
        pairs = {key: (before.get(key), value) for key, value in settled.items()}
        pairs |= {
            f"{key}.{name}": (known[key].get(name, value), value) for key in growing for name, value in growing[key].items()
        }
        for key, (old, new) in pairs.items():
            if old != new:
                raise UsageError("was begun with other settings", where=path.parent, why=f"{key} was {_said(old)}, and is {_said(new)} now",
                             remedy="choose another --out")  # fmt: skip
    else:
        files.refuse_existing(path.parent)
        known = {key: {} for key in growing}
    content = {"format": kind, "version": version, **settled, **{key: known[key] | dict(growing[key]) for key in growing}}
    files.write_json(path, content)


def _said(value: Any) -> str:
    """A setting as one gives it."""
    return " ".join(map(str, value or ["nothing"])) if isinstance(value, list) else "nothing" if value is None else str(value)
