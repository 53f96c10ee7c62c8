"""The drawings of a sweep's page, as SVG: error against time, and what each setting gains over the base."""

from collections.abc import Sequence

import numpy as np

from koala3d.datasets.reports.drawing import GREY, blank, svg_of
from koala3d.reconstruct.experiments.results import Row
from koala3d.reconstruct.experiments.statistics import welch
from koala3d.reconstruct.experiments.tables import shown
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER, column_heading

DRAWN = ("psnr", "normal_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm")
"""A panel each, if any row has a value."""
COLOURS = ("#2f6fde", "#d98324", "#3a9d5d", "#b3479a", "#8a8f2b", "#c74545", "#4aa3b5", "#7a5cc7")


def curves(rows: Sequence[Row]) -> str:
    """Error against seconds of training: a line per model and setting, and the Pareto front."""
    columns = [name for name in DRAWN if any(row.values.get(name) is not None for row in rows)]
    figure = blank(3.3 * len(columns) + 0.4, 3.2)
    for panel, column in enumerate(columns):
        axes, reached = figure.add_subplot(1, len(columns), panel + 1), []
        for number, name in enumerate(dict.fromkeys(row.origin.name for row in rows)):
            points = curve([row for row in rows if row.origin.name == name], column)
            if points:
                seconds, mean, deviation = np.array(points).T
                style = {"marker": "o", "markersize": 3.5, "capsize": 2, "linewidth": 1.4}
                axes.errorbar(seconds, mean, deviation, color=COLOURS[number % len(COLOURS)], label=name, **style)
                reached += list(zip(seconds, mean, strict=True))
        if len(edge := front(reached, higher=column in HIGHER_IS_BETTER)) > 1:
            axes.plot(*zip(*edge, strict=True), color=GREY, linewidth=5, alpha=0.22, zorder=0, solid_capstyle="round")
        axes.set_xscale("log")
        ticks = sorted({row.origin.budget_s for row in rows if row.origin.budget_s is not None})
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlabel="seconds of training")
        axes.set_title(column_heading(column), fontsize=9.5)
        axes.grid(alpha=0.25)
        if panel == 0:
            axes.legend(frameon=False, fontsize=8)
    return svg_of(figure)


def curve(rows: Sequence[Row], column: str) -> list[tuple[float, float, float]]:
    """(seconds, mean, standard deviation or 0) of a figure at each budget."""
    found = []
    for row in rows:
        value, budget = row.values.get(column), row.origin.budget_s
        if value is not None and budget is not None:
            found.append((budget, value, row.deviations.get(column, 0.0)))
    return sorted(found)


def front(points: Sequence[tuple[float, float]], *, higher: bool) -> list[tuple[float, float]]:
    """The (seconds, value) that no other point beats in at most the same time, by time."""
    edge: list[tuple[float, float]] = []
    for seconds, value in sorted(points, key=lambda point: (point[0], -point[1] if higher else point[1])):
        if not edge or (value > edge[-1][1] if higher else value < edge[-1][1]):
            edge.append((seconds, value))
    return edge


def gains(base: Row, others: Sequence[Row]) -> str:
    """What each row gains over the base, with confidence intervals: a panel per column of `DRAWN`."""
    columns = [name for name in DRAWN if base.values.get(name) is not None]
    figure = blank(5 * max(len(columns), 1), 1 + 0.32 * (len(others) + 1))
    for index, column in enumerate(columns):
        axes = figure.add_subplot(1, len(columns), index + 1)
        sign, reference = 1 if column in HIGHER_IS_BETTER else -1, base.sample(column)
        samples = {row.label: sample for row in others if (sample := row.sample(column)) is not None}
        changes = [welch(reference, sample) for sample in samples.values()] if reference is not None else []
        gained = [sign * change.value for change in changes]
        reach = [0.0 if np.isnan(change.high) else change.high - change.value for change in changes]
        axes.barh(list(samples), gained, color=[COLOURS[0] if gain >= 0 else COLOURS[1] for gain in gained])
        axes.errorbar(gained, list(samples), xerr=reach, fmt="none", ecolor="#303030", elinewidth=1, capsize=2)
        axes.axvline(0, color=GREY, linewidth=0.8)
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3)
        axes.set_title(f"{column_heading(column)}, base {shown(base, column)}", fontsize=9)
        axes.set_xlabel("gain over the base (better to the right)", fontsize=8)
        axes.tick_params(labelsize=8)
    return svg_of(figure)
