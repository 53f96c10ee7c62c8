"""Ablations: one model trained repeatedly with one change at a time, into one table and one figure.

OUT/study.json               scene, model, preset, common overrides, and the cells: name and what it changes
OUT/cells/NAME/seed_N/       a run per cell and seed
OUT/table.md .csv .tex, OUT/figure.png, OUT/index.html

An interrupted study is resumed; further cells and seeds can be added.
"""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.formats import find
from koala3d.datasets.reports.drawing import svg_of
from koala3d.datasets.reports.html import Number, ReportPage
from koala3d.reconstruct.config import Config, LossConfig, SurfaceConfig
from koala3d.reconstruct.output import metric_names
from koala3d.reconstruct.output.evaluate import METRICS
from koala3d.reconstruct.studies import results_table
from koala3d.reconstruct.studies.jobs import BASE, CELLS, Job, Recipe, chosen_seeds, open_study, run_all
from koala3d.reconstruct.studies.results import Row, row_of_seeds
from koala3d.reconstruct.studies.seeds import seed_folder, welch

FORMAT, VERSION = "koala-study", 2
STUDY = "study.json"
DRAWN = ("psnr", "normal_mae_alpha_acc_deg")
LOSSES = ("density", "normal", "bias", "variation")
PUBLISHED, REFNERF = SurfaceConfig(), LossConfig()  # their default weights
NO_PASS = "surface.enabled=false"
Cells = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Study:
    """Trainings of an ablation."""

    recipe: Recipe  # common to all cells
    seeds: tuple[int, ...]  # each cell is trained with each seed
    cells: Cells  # overrides of each cell by name


def grid(base: Config) -> Cells:
    """The paper's ablations around a configuration, by name, without cells that would repeat the base.

    Sampling of the sphere, neighbours of the total variation (also as in the published implementation), frequency of the second
    pass, form of the density smoothness, each loss disabled (or, if the base disables it, enabled with the published weight), and
    no hollowness. "no second pass" disables the four regularisers; "no regulariser" leaves the losses of Ref-NeRF at its weights.
    """
    cells: Cells = {BASE: ()}
    surface = base.surface
    for kind in ("lattice", "fibonacci", "random"):
        cells[f"sampling {kind}"] = (f"surface.sampling={kind}",)
    for k in (1, 3, 5, 8):
        cells[f"k = {k}"] = (f"surface.neighbours={k}",)
    cells["published neighbours"] = ("surface.neighbour_form=published", "surface.neighbours=5")
    for first, last in ((2048, 16), (512, 4), (256, 2), (16, 16)):
        cells[f"every {first}/{last}"] = (f"surface.first_period={first}", f"surface.last_period={last}")
    for form in ("solid", "tangent", "published"):
        weight = surface.density or PUBLISHED.density
        cells[f"{form} density"] = (f"surface.density_form={form}", f"surface.density={weight}")
    cells = {name: changes for name, changes in cells.items() if name == BASE or not _repeats(surface, changes)}
    for loss in LOSSES:
        weight = getattr(surface, loss)
        if weight:
            cells[f"without {loss}"] = (f"surface.{loss}=0",)
        elif loss != "density":  # its forms are cells
            cells[f"with {loss}"] = (f"surface.{loss}={getattr(PUBLISHED, loss)}",)
    if base.losses.hollowness:
        cells["without hollowness"] = ("losses.hollowness=0",)
    cells["no second pass"] = (NO_PASS,)
    normals = [f"losses.{name}={getattr(REFNERF, name)}" for name in ("predicted_normals", "density_normals")]
    return cells | {"no regulariser": (NO_PASS, "losses.hollowness=0", *normals, "losses.last_density_normals=null")}


def _repeats(surface: SurfaceConfig, changes: Sequence[str]) -> bool:
    pairs = (change.removeprefix("surface.").split("=") for change in changes)
    return all(str(getattr(surface, name)) == value for name, value in pairs)


def plan(
    scene: str,
    model: str,
    preset: str,
    overrides: Sequence[str],
    budget_s: float | None,
    wanted: Sequence[str],
    seeds: Sequence[int] = (),
) -> Study:
    """The study of the wanted cells (default: all of `grid`; always with the base) and seeds (default: the model's own).

    Raises UsageError: unknown scene, model, setting or cell, or a seed given twice.
    """
    recipe = Recipe(str(find(scene).resolve()), model, preset, tuple(overrides), budget_s)
    base = recipe.config()
    cells = grid(base)
    for name in wanted:
        if name not in cells:
            raise UsageError(f"there is no cell '{name}'", where="--cell", remedy=nearest(name, cells))
    chosen = {name: changes for name, changes in cells.items() if not wanted or name in wanted or name == BASE}
    return Study(recipe, chosen_seeds(base, seeds), chosen)


def run(study: Study, out: Path) -> dict[str, Any]:
    """Run every cell with every seed that is not finished, then write the table, the figure and the report.

    Raises UsageError: `out` holds something else, or a study of something else.
    """
    cells = {name: list(changes) for name, changes in study.cells.items()}
    settings = study.recipe.content("scene", "model", "preset", "overrides", "budget_s")
    cells = open_study(out / STUDY, kind=FORMAT, version=VERSION, settings=settings, members={"cells": cells})["cells"]
    jobs = []
    for seed, (name, changes) in product(study.seeds, study.cells.items()):
        place = out / CELLS / folder_name(name) / seed_folder(seed)
        jobs.append(Job(place, study.recipe, (*changes, f"train.seed={seed}")))
    run_all(jobs, "ablating")
    rows = [replace(row, label=name) for name, row in _finished(cells, out).items()]
    columns = results_table.chosen_columns(rows)
    results_table.write_all(rows, columns, out)
    with files.atomic_path(out / "figure.png") as temporary:
        draw(rows, columns).savefig(temporary, dpi=150)
    files.write_text(out / "index.html", page(rows, columns, study, cells, out).render())
    written = {"table": str(out / "table.md"), "figure": str(out / "figure.png"), "report": str(out / "index.html")}
    content = [{"cell": row.label, **row.content(columns)} for row in rows]
    return {"out": str(out), "cells": len(rows), **written, "rows": content}


def folder_name(cell: str) -> str:
    """Folder name of a cell."""
    return cell.replace(" = ", "_").replace(" ", "_").replace("/", "_")


def _finished(cells: Iterable[str], out: Path) -> dict[str, Row]:
    """Metrics of each cell over its evaluated seeds, by name; without cells that have none."""
    runs = {name: sorted(path.parent for path in (out / CELLS / folder_name(name)).glob(f"*/{METRICS}")) for name in cells}
    return {name: row_of_seeds(paths) for name, paths in runs.items() if paths}


def page(rows: Sequence[Row], columns: Sequence[str], study: Study, cells: Mapping[str, Sequence[str]], out: Path) -> ReportPage:
    """The report of a study: each cell's gain over the base, all metrics, the changes of each cell."""
    recipe = study.recipe
    report = ReportPage(f"Ablation of {recipe.model} on {Path(recipe.scene).name}", made_by=[_command(study, cells, out)])
    base = next((row for row in rows if row.label == BASE), rows[0])
    headings = [metric_names.column_heading(name) for name in columns]
    headline = zip(headings[:4], (_number(base, name) for name in columns[:4]), strict=True)
    report.headline(headline, f"the base, and {len(rows) - 1} other{'s' if len(rows) > 2 else ''}")
    report.section("Gain over the base", f"Better is to the right. {_uncertainty(rows)}")
    report.drawing(svg_of(draw(rows, columns)))
    report.section("All metrics")
    body = [(row.label, *(_number(row, name) for name in columns), " ".join(cells[row.label])) for row in rows]
    report.table(("cell", *headings, "changes"), body)
    report.items(f"{heading}: {metric_names.definition(name)}" for heading, name in zip(headings, columns, strict=True))
    return report


def _number(row: Row, name: str) -> Number:
    return Number(row.values.get(name), std=row.deviations.get(name))


def _command(study: Study, cells: Mapping[str, Sequence[str]], out: Path) -> str:
    """The command line that makes a study."""
    recipe = study.recipe
    options = [f"--model {recipe.model} --preset {recipe.preset}"]
    options += [] if recipe.budget_s is None else [f"--budget {recipe.budget_s:g}"]
    options += [f"--set {shlex.quote(override)}" for override in recipe.overrides]
    options += [f"--seed {seed}" for seed in study.seeds]
    if not set(cells) >= set(grid(recipe.config())):
        options += [f"--cell {shlex.quote(name)}" for name in cells if name != BASE]
    return " ".join([f"reconstruct ablate {recipe.scene}", *options, f"--out {out}"])


def _uncertainty(rows: Sequence[Row]) -> str:
    """How reliable the differences are."""
    if max(row.seeds for row in rows) == 1:
        return "One seed each: small differences may be noise."
    return "Bars: differences of the means over seeds. Lines: 95 % confidence intervals (Welch); one that includes zero is noise."


def draw(rows: Sequence[Row], columns: Sequence[str]):
    """A figure with a panel per column of `DRAWN`: each cell's gain over the base with its confidence interval.

    Returns:
        A matplotlib Figure.
    """
    from matplotlib.figure import Figure

    columns = [name for name in DRAWN if name in columns]
    figure = Figure(figsize=(5 * max(len(columns), 1), 1 + 0.32 * len(rows)), layout="constrained")
    base = next((row for row in rows if row.label == BASE), rows[0])
    for index, column in enumerate(columns):
        axes = figure.add_subplot(1, len(columns), index + 1)
        sign = 1 if column in metric_names.HIGHER_IS_BETTER else -1
        reference = base.sample(column)
        others = {row.label: sample for row in rows if row is not base and (sample := row.sample(column)) is not None}
        changes = [welch(reference, sample) for sample in others.values()] if reference is not None else []
        gains = [sign * change.value for change in changes]
        reach = [0.0 if np.isnan(change.high) else change.high - change.value for change in changes]
        axes.barh(list(others), gains, color=["#2f6fde" if gain >= 0 else "#d98324" for gain in gains])
        axes.errorbar(gains, list(others), xerr=reach, fmt="none", ecolor="#303030", elinewidth=1, capsize=2)
        axes.axvline(0, color="#808080", linewidth=0.8)
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3)
        axes.set_title(f"{metric_names.column_heading(column)}, base {results_table.shown(base, column)}", fontsize=9)
        axes.set_xlabel("gain over the base (better to the right)", fontsize=8)
        axes.tick_params(labelsize=8)
    return figure
