"""Results of trainings, a JSON file each, and rows of them: those that differ only in their seed make one row.

OUT/SCENE/MODEL/SETTING/seed_N.json    figures of an evaluation, time, rates and memory, machine and versions
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.experiments.statistics import Sample
from koala3d.reconstruct.output import evaluate
from koala3d.reconstruct.run import RUN, Run

FORMAT, VERSION = "koala-result", 1
RESULTS = "*/*/*/seed_*.json"
"""The files in the folder of a sweep."""
WORK = {
    "steps": "steps of the training",
    "training_s": "seconds spent in training steps: the budget",
    "preparation_s": "seconds to read the images and analyse the scene",
    "compilation_s": "seconds to compile the training step, or to load it",
    "rays_per_s": "rays drawn per second of training, including those that miss the object",
    "samples_per_s": "samples per second of training, including unused capacity",
    "peak_memory_mb": "largest resident set of the process, including evaluation",
}


def seed_folder(seed: int) -> str:
    """Folder name of a seed's run."""
    return f"seed_{seed}"


class Origin(NamedTuple):
    """What was trained on a scene."""

    model: str
    preset: str = ""
    setting: str = ""
    """Name of what was changed; "" for a run outside sweeps."""
    budget_s: float | None = None

    @property
    def name(self) -> str:
        """In words, without preset and budget."""
        return self.model if self.setting in ("", "base") else f"{self.model}, {self.setting}"

    def __str__(self) -> str:
        budget = "" if self.budget_s is None else f", {self.budget_s:g} s"
        return f"{self.name}, {self.preset}{budget}"


NOTHING = Origin("")


@dataclass(frozen=True)
class Result:
    """One evaluated training."""

    path: Path
    """Its folder."""
    scene: str
    origin: Origin
    seed: int
    training: dict[str, Any]
    """All else that a seed does not change: path of the scene, devices, configuration."""
    evaluation: dict[str, Any]
    """Content of metrics.json."""
    work: dict[str, float] = field(default_factory=dict)
    """See `WORK`."""
    machine: dict[str, Any] = field(default_factory=dict)
    """See `machine.describe`."""

    @classmethod
    def of_run(
        cls, path: Path, *, setting: str = "", work: dict[str, float] | None = None, machine: dict[str, Any] | None = None
    ) -> "Result":
        """The result of a run on disk. Raises UsageError: not a run, or not evaluated."""
        run = Run.open(path)
        if not (run.path / evaluate.METRICS).is_file():
            raise UsageError("has not been evaluated", where=run.path, remedy=f"run: reconstruct eval {run.path}")
        about, config = run.content, run.config
        origin = Origin(config.model + (", fine-tuned" if "from" in about else ""), config.preset, setting, about.get("budget_s"))
        settings = config.model_dump(mode="json", exclude={"train": {"seed"}})
        training = {name: about.get(name) for name in ("scene", "device", "devices")} | {"config": settings}
        measured = files.read_json(run.path / evaluate.METRICS, kind=evaluate.FORMAT, version=evaluate.VERSION)
        scene = about.get("scene_name", Path(run.scene_path).name)
        return cls(run.path, scene, origin, config.train.seed, training, measured, work or {}, machine or {})

    @classmethod
    def read(cls, path: Path) -> "Result":
        """The result in a file. Raises DatasetError: it is incomplete."""
        content = files.read_json(path, kind=FORMAT, version=VERSION)
        try:
            own = {name: content[name] for name in ("scene", "seed", "training", "evaluation", "work", "machine")}
            return cls(path.with_suffix(""), origin=Origin(**content["origin"]), **own)
        except (KeyError, TypeError) as error:
            raise DatasetError("result is incomplete", where=path, why=str(error)) from None

    def content(self) -> dict[str, Any]:
        """The result for a file."""
        own = {key: value for key, value in asdict(self).items() if key not in ("path", "origin")}
        return {"format": FORMAT, "version": VERSION, "origin": self.origin._asdict(), **own}

    @property
    def folder(self) -> str:
        """Name of the training on disk."""
        path = self.path.resolve()
        return path.parent.name if path.name == seed_folder(self.seed) else path.name

    @property
    def recipe(self) -> str:
        """Everything that a seed does not change, and how the mesh was cut."""
        return json.dumps([self.scene, self.origin, self.training, self.evaluation.get("mesh_stands_on")], sort_keys=True)

    def row(self, label: str) -> "Row":
        """Its own row."""
        values = {**self.evaluation["mean"], **(self.evaluation.get("mesh") or {}), **self.work}
        return Row(self.scene, label, values, self.evaluation.get("mesh_stands_on"), origin=self.origin)

    def image_rows(self, label: str) -> list["Row"]:
        """A row per image."""
        return [Row(f"{self.scene}, {label}", view["name"], view) for view in self.evaluation["per_view"]]


@dataclass(frozen=True)
class Row:
    """Figures of a training, or of several seeds."""

    scene: str
    label: str
    values: dict[str, float | None]
    stands_on: str | None = None  # side of the box that the object stands on, if the mesh was cut accordingly
    deviations: dict[str, float] = field(default_factory=dict)  # standard deviations over seeds by name; empty for one seed
    seeds: int = 1
    origin: Origin = NOTHING

    def sample(self, name: str) -> Sample | None:
        """A figure with its spread; None if it was not measured."""
        value = self.values.get(name)
        return None if value is None else Sample(value, self.deviations.get(name, np.nan), self.seeds)

    def content(self, names: Iterable[str]) -> dict[str, Any]:
        """Figures by name; deviations end in _std."""
        found: dict[str, Any] = {}
        for name in names:
            found[name] = self.values.get(name)
            if name in self.deviations:
                found[f"{name}_std"] = self.deviations[name]
        return found | ({"seeds": self.seeds} if self.seeds > 1 else {})


def results_of(folders: Sequence[Path]) -> list[Result]:
    """Results of sweeps and of single runs, in the order of the folders. Raises UsageError: a folder holds none."""
    found = []
    for folder in folders:
        if (folder / RUN).is_file():
            found.append(Result.of_run(folder))
        elif paths := list(folder.glob(RESULTS)):
            base_first = lambda path: (path.parents[1], not path.parent.name.startswith("base"), path)  # noqa: E731
            found += map(Result.read, sorted(paths, key=base_first))
        else:
            raise UsageError("holds no results", where=folder, remedy="give a run, or a folder made by 'reconstruct sweep'")
    return found


def rows_of(results: Sequence[Result], *, per_image: bool = False) -> list[Row]:
    """A row for the seeds of each training, or one per image of each, in the order of the results, grouped by scene.

    Raises DatasetError: a result is incomplete.
    """
    rows, labels = [], set()
    budgets = {(one.scene, one.origin._replace(budget_s=None)): set() for one in results}
    for one in results:
        budgets[one.scene, one.origin._replace(budget_s=None)].add(one.origin.budget_s)
    for group in [[one] for one in results] if per_image else _by_recipe(results):
        scene, origin = group[0].scene, group[0].origin
        label = origin.name
        if origin.budget_s is not None and len(budgets[scene, origin._replace(budget_s=None)]) > 1:
            label += f", {origin.budget_s:g} s"
        while (scene, label) in labels:  # folders distinguish two trainings of one model
            label = f"{label} ({group[0].folder})" if "(" not in label else f"{label}'"
        labels.add((scene, label))
        try:
            rows += group[0].image_rows(label) if per_image else [over_seeds([one.row(label) for one in group])]
        except (KeyError, TypeError) as error:
            places = ", ".join(str(one.path) for one in group)
            raise DatasetError("metrics are incomplete", where=places, why=str(error)) from None
    order = list(dict.fromkeys(row.scene for row in rows))
    return sorted(rows, key=lambda row: order.index(row.scene))


def over_seeds(rows: Sequence[Row]) -> Row:
    """Means and standard deviations of rows that differ only in their seed; a figure must be present in all rows."""
    if len(rows) == 1:
        return rows[0]
    columns = {name: [row.values.get(name) for row in rows] for name in rows[0].values}
    complete = {name: [value for value in column if value is not None] for name, column in columns.items()}
    samples = {name: Sample.of(column) for name, column in complete.items() if len(column) == len(rows)}
    values = {name: samples[name].mean if name in samples else None for name in columns}
    deviations = {name: sample.deviation for name, sample in samples.items()}
    return replace(rows[0], values=values, deviations=deviations, seeds=len(rows))


def _by_recipe(results: Sequence[Result]) -> list[list[Result]]:
    """Results grouped by recipe; a repeated seed starts another group, since it is no further sample."""
    groups: list[list[Result]] = []
    for one in results:
        for group in groups:
            if group[0].recipe == one.recipe and one.seed not in (other.seed for other in group):
                group.append(one)
                break
        else:
            groups.append([one])
    return groups
