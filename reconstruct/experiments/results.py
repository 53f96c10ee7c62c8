"""Metrics of evaluated runs as rows; runs that differ only in their seed make one row of means and deviations."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.reconstruct.output.evaluate import FORMAT, METRICS, VERSION
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.studies.seeds import Sample, seed_folder


@dataclass(frozen=True)
class Row:
    """Metrics of a run, or of several seeds."""

    scene: str
    label: str
    values: dict[str, float | None]
    stands_on: str | None = None  # side of the box that the object stands on, if the mesh was cut accordingly
    deviations: dict[str, float] = field(default_factory=dict)  # standard deviations over seeds by metric; empty for one seed
    seeds: int = 1

    def sample(self, name: str) -> Sample | None:
        """A metric with its spread; None if it was not measured."""
        value = self.values.get(name)
        return None if value is None else Sample(value, self.deviations.get(name, np.nan), self.seeds)

    def content(self, names: Iterable[str]) -> dict[str, Any]:
        """Metrics by name; deviations end in _std."""
        found: dict[str, Any] = {}
        for name in names:
            found[name] = self.values.get(name)
            if name in self.deviations:
                found[f"{name}_std"] = self.deviations[name]
        return found | ({"seeds": self.seeds} if self.seeds > 1 else {})


@dataclass(frozen=True)
class _Measured:
    """A run and its evaluation."""

    run: Run
    result: dict[str, Any]

    @classmethod
    def open(cls, path: Path) -> "_Measured":
        run = Run.open(path)
        if not (run.path / METRICS).is_file():
            raise UsageError("has not been evaluated", where=run.path, remedy=f"run: reconstruct eval {run.path}")
        return cls(run, files.read_json(run.path / METRICS, kind=FORMAT, version=VERSION))

    @property
    def scene(self) -> str:
        return self.run.content.get("scene_name", Path(self.run.scene_path).name)

    @property
    def label(self) -> str:
        return self.run.config.model + (", fine-tuned" if "from" in self.run.content else "")

    @property
    def folder(self) -> str:
        """Name of the training on disk."""
        path = self.run.path.resolve()
        return path.parent.name if path.name == seed_folder(self.seed) else path.name

    @property
    def seed(self) -> int:
        return self.run.config.train.seed

    @property
    def recipe(self) -> str:
        """Everything that a seed does not change: scene, settings, budget, device, and how the mesh was cut."""
        about = [self.run.content.get(key) for key in ("scene", "budget_s", "device", "devices")]
        config = self.run.config.model_dump(mode="json", exclude={"train": {"seed"}})
        return json.dumps([self.scene, self.label, *about, self.result.get("mesh_stands_on"), config], sort_keys=True)

    def row(self, label: str) -> Row:
        values = {**self.result["mean"], **(self.result.get("mesh") or {})}
        return Row(self.scene, label, values, self.result.get("mesh_stands_on"))

    def image_rows(self, label: str) -> list[Row]:
        return [Row(f"{self.scene}, {label}", view["name"], view) for view in self.result["per_view"]]


def rows_of_runs(runs: Sequence[Path], *, per_image: bool = False) -> list[Row]:
    """A row for the seeds of each training, or one per image of each run, in the order of the runs, grouped by scene.

    Raises UsageError: not a run, or not evaluated.
    """
    measured = [_Measured.open(path) for path in runs]
    rows, labels = [], set()
    for group in [[one] for one in measured] if per_image else _by_recipe(measured):
        scene, label = group[0].scene, group[0].label
        while (scene, label) in labels:  # folders distinguish two trainings of one model
            label = f"{label} ({group[0].folder})" if "(" not in label else f"{label}'"
        labels.add((scene, label))
        try:
            rows += group[0].image_rows(label) if per_image else [over_seeds([one.row(label) for one in group])]
        except (KeyError, TypeError) as error:
            places = ", ".join(str(one.run.path / METRICS) for one in group)
            raise DatasetError("metrics are incomplete", where=places, why=str(error)) from None
    order = list(dict.fromkeys(row.scene for row in rows))
    return sorted(rows, key=lambda row: order.index(row.scene))


def row_of_seeds(runs: Sequence[Path]) -> Row:
    """The row of runs that differ only in their seed. Raises UsageError: they differ in more, or one was not evaluated."""
    rows = rows_of_runs(runs)
    if len(rows) > 1:
        why, advice = "they differ in settings, budget or device", "remove the older runs, or choose another --out"
        raise UsageError("seeds were not trained alike", where=runs[0].parent, why=why, remedy=advice)
    return rows[0]


def over_seeds(rows: Sequence[Row]) -> Row:
    """Means and standard deviations of rows that differ only in their seed; a metric must be present in all rows."""
    if len(rows) == 1:
        return rows[0]
    columns = {name: [row.values.get(name) for row in rows] for name in rows[0].values}
    complete = {name: [value for value in column if value is not None] for name, column in columns.items()}
    samples = {name: Sample.of(column) for name, column in complete.items() if len(column) == len(rows)}
    values = {name: samples[name].mean if name in samples else None for name in columns}
    deviations = {name: sample.deviation for name, sample in samples.items()}
    return replace(rows[0], values=values, deviations=deviations, seeds=len(rows))


def _by_recipe(measured: Sequence[_Measured]) -> list[list[_Measured]]:
    """Runs grouped by recipe; a repeated seed starts another group, since it is no further sample."""
    groups: list[list[_Measured]] = []
    for one in measured:
        for group in groups:
            if group[0].recipe == one.recipe and one.seed not in (other.seed for other in group):
                group.append(one)
                break
        else:
            groups.append([one])
    return groups
