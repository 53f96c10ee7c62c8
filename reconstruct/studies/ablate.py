"""Ablations: one model trained again and again with one thing changed, into one table and one figure.

OUT/study.json               scene, model, preset, common overrides, and the cells: name and what it changes
OUT/cells/NAME/seed_N/       a run per cell and seed
OUT/table.md .csv .tex, OUT/figure.png, OUT/index.html

What was measured is not run again, what was broken off is gone on with, so that a study can be stopped at any time, and
further cells and seeds can be added to it.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.core import files
from datasets.core.console import progress
from datasets.core.errors import UsageError, nearest
from datasets.formats import find
from datasets.reports.drawing import svg_of
from datasets.reports.html import Number, ReportPage
from reconstruct.config import Config, LossConfig, SurfaceConfig
from reconstruct.output import metric_names
from reconstruct.output.evaluate import METRICS
from reconstruct.studies import results_table
from reconstruct.studies.recipe import Recipe, begin, chosen_seeds, finish
from reconstruct.studies.results import Row, row_of_seeds
from reconstruct.studies.seeds import seed_folder, welch

FORMAT, VERSION = "koala-study", 2
STUDY, CELLS = "study.json", "cells"
BASE = "base"
FIGURES = ("psnr", "normal_mae_alpha_acc_deg")
"""Columns that the figure draws."""
LOSSES = ("density", "normal", "bias", "variation")
PUBLISHED, REFNERF = SurfaceConfig(), LossConfig()
"""The weights of both, where nothing else is said."""
NO_PASS = "surface.enabled=false"
Cells = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class Study:
    """What an ablation trains."""

    recipe: Recipe
    """Common to all cells."""
    seeds: tuple[int, ...]
    """Each cell is trained with each of them."""
    cells: Cells
    """Overrides of each cell, by its name."""


def grid(base: Config) -> Cells:
    """The paper's ablations around a configuration, by name; a cell that would repeat the base is left out.

    Sampling of the sphere, neighbours of the total variation (and as the published implementation has them), frequency of the
    second pass, form of the density smoothness, each loss without (or, where the base has it off, with the published weight), and
    the base without hollowness. "no second pass" has none of the four regularisers; "no regulariser" has the losses that Ref-NeRF
    has, at its weights.
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
    for form in ("tangent", "published"):
        cells[f"{form} density"] = (
            f"surface.density_form={form}",
            f"surface.density={surface.density or PUBLISHED.density}",
        )
    cells = {name: changes for name, changes in cells.items() if name == BASE or not _repeats(surface, changes)}
    for loss in LOSSES:
        weight = getattr(surface, loss)
        if weight:
            cells[f"without {loss}"] = (f"surface.{loss}=0",)
        elif loss != "density":  # its forms are cells already
            cells[f"with {loss}"] = (f"surface.{loss}={getattr(PUBLISHED, loss)}",)
    if base.losses.hollowness:
        cells["without hollowness"] = ("losses.hollowness=0",)
    cells["no second pass"] = (NO_PASS,)
    return cells | {
        "no regulariser": (
            NO_PASS,
            "losses.hollowness=0",
            f"losses.predicted_normals={REFNERF.predicted_normals}",
            f"losses.density_normals={REFNERF.density_normals}",
        )
    }


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
    """The study of the wanted cells (all of `grid` where none is named; the base always) with some seeds, or the model's own.

    Raises:
        UsageError: unknown scene, model, setting or cell, or a seed twice.
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
    """Train and measure every cell with every seed as far as that is not finished, then write the table and the figure.

    Raises:
        UsageError: `out` holds something else, or a study of something else.
    """
    cells = {name: list(changes) for name, changes in study.cells.items()}
    settled = study.recipe.content("scene", "model", "preset", "overrides", "budget_s")
    begin(out / STUDY, kind=FORMAT, version=VERSION, settled=settled, growing={"cells": cells})
    with progress("ablating", len(study.seeds) * len(study.cells), "trainings") as shown:
        for seed in study.seeds:
            for name, changes in study.cells.items():
                shown.note(f"{name}, seed {seed}")
                finish(out / CELLS / folder_name(name) / seed_folder(seed), study.recipe, [*changes, f"train.seed={seed}"])
                shown.advance()
    rows = [replace(row, label=name) for name, row in _finished(out).items()]
    columns = results_table.chosen_columns(rows)
    results_table.write_all(rows, columns, out)
    drawn = [name for name in FIGURES if name in columns]
    with files.atomic_path(out / "figure.png") as temporary:
        draw(rows, drawn).savefig(temporary, dpi=150)
    files.write_text(out / "index.html", page(rows, columns, study, out, svg_of(draw(rows, drawn))).render())
    return {"out": str(out), "cells": len(rows), "table": str(out / "table.md"), "figure": str(out / "figure.png"), "report": str(out / "index.html"),
            "rows": [{"cell": row.label, **row.content(columns)} for row in rows]}  # fmt: skip


def folder_name(cell: str) -> str:
    """A cell's name as a folder's."""
    return cell.replace(" = ", "_").replace(" ", "_").replace("/", "_")


def _finished(out: Path) -> dict[str, Row]:
    """The figures of each cell over the seeds that were measured, by its name; without those of which none was."""
    cells = files.read_json(out / STUDY, kind=FORMAT, version=VERSION)["cells"]
    runs = {name: sorted(path.parent for path in (out / CELLS / folder_name(name)).glob(f"*/{METRICS}")) for name in cells}
    return {name: row_of_seeds(paths) for name, paths in runs.items() if paths}


def page(rows: Sequence[Row], columns: Sequence[str], study: Study, out: Path, drawing: str) -> ReportPage:
    """The study as a page: each cell's gain over the base, all figures, what each cell changes."""
    recipe = study.recipe
    budget = "" if recipe.budget_s is None else f" --budget {recipe.budget_s:g}"
    common = "".join(f" --set {shlex.quote(override)}" for override in recipe.overrides)
    cells = files.read_json(out / STUDY, kind=FORMAT, version=VERSION)["cells"]
    every = set(cells) >= set(grid(recipe.config()))
    named = "" if every else "".join(f" --cell {shlex.quote(name)}" for name in cells if name != BASE)
    seeds = "".join(f" --seed {seed}" for seed in study.seeds)
    command = f"reconstruct ablate {recipe.scene} --model {recipe.model} --preset {recipe.preset}{budget}{common}{seeds}{named} --out {out}"
    report = ReportPage(f"Ablation of {recipe.model} on {Path(recipe.scene).name}", made_by=[command])
    base = next((row for row in rows if row.label == BASE), rows[0])
    number = lambda row, name: Number(row.values.get(name), std=row.deviations.get(name))  # noqa: E731
    report.headline(
        [(metric_names.column_heading(name), number(base, name)) for name in columns[:4]],
        f"the base, and {len(rows) - 1} other{'s' if len(rows) > 2 else ''}",
    )
    report.section("Gain over the base", f"Better is to the right. {_doubt(rows)}")
    report.drawing(drawing)
    report.section("All figures")
    report.table(("cell", *(metric_names.column_heading(name) for name in columns), "changes"),
                 [(row.label, *(number(row, name) for name in columns), " ".join(cells[row.label])) for row in rows])  # fmt: skip
    report.items(f"{metric_names.column_heading(name)}: {metric_names.definition(name)}" for name in columns)
    return report


def _doubt(rows: Sequence[Row]) -> str:
    """How far the differences can be trusted."""
    if max(row.seeds for row in rows) == 1:
        return "One seed each: a difference that another seed could make is none."
    return "Bars are differences of means over seeds, lines their intervals of 95 % confidence (Welch's): one that reaches zero is none."


def draw(rows: Sequence[Row], columns: Sequence[str]):
    """A figure with a panel per column: each cell's distance from the base, better to the right, with its confidence.

    Returns:
        A matplotlib Figure.
    """
    from matplotlib.figure import Figure

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
