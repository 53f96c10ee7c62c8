"""The drawings of a benchmark's report, as SVG: error against time, and where the time of a step goes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from koala3d.datasets.reports.drawing import GREY, blank, svg_of
from koala3d.reconstruct.bench.records import Row
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER, column_heading

METRICS = ("psnr", "normal_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm")  # one panel each, if any row has a value
COLOURS = ("#2f6fde", "#d98324", "#3a9d5d", "#b3479a", "#8a8f2b", "#c74545", "#4aa3b5", "#7a5cc7")


def pareto(rows: Sequence[Row], peers: Sequence[Row] = ()) -> str:
    """Error against seconds: a line per model and preset, other programs as crosses, and the Pareto front."""
    metrics = [name for name in METRICS if any(row.get(name) is not None for row in rows)] or list(METRICS[:1])
    figure = blank(3.3 * len(metrics) + 0.4, 3.2)
    for panel, metric in enumerate(metrics):
        axes = figure.add_subplot(1, len(metrics), panel + 1)
        reached = _draw_models(axes, rows, metric)
        _draw_peers(axes, peers, metric)
        if len(edge := front(reached, higher=metric in HIGHER_IS_BETTER)) > 1:
            axes.plot(*zip(*edge, strict=True), color=GREY, linewidth=5, alpha=0.22, zorder=0, solid_capstyle="round")
        axes.set_xscale("log")
        ticks = sorted({row["budget_s"] for row in rows})
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlabel="seconds of training", title=column_heading(metric))
        _style(axes)
        if panel == 0:
            axes.legend(frameon=False, fontsize=8)
    return svg_of(figure)


def _draw_models(axes: Any, rows: Sequence[Row], metric: str) -> list[tuple[float, float]]:
    """A line with error bars per model and preset; returns all (seconds, mean)."""
    reached: list[tuple[float, float]] = []
    names = dict.fromkeys((row["model"], row["preset"]) for row in rows)
    for colour, name in zip(_colours(len(names)), names, strict=False):
        points = spread([row for row in rows if (row["model"], row["preset"]) == name], metric)
        if points:
            seconds, mean, low, high = np.array(points).T
            bars = np.maximum([mean - low, high - mean], 0)
            style = {"marker": "o", "markersize": 3.5, "capsize": 2, "linewidth": 1.4}
            axes.errorbar(seconds, mean, bars, color=colour, label=" ".join(name), **style)
            reached += list(zip(seconds, mean, strict=True))
    return reached


def _draw_peers(axes: Any, peers: Sequence[Row], metric: str) -> None:
    """Crosses for the results of other programs."""
    programs = dict.fromkeys(peer["program"] for peer in peers)
    for colour, program in zip(reversed(COLOURS), programs, strict=False):
        block = [peer for peer in peers if peer["program"] == program]
        points = [(peer["seconds"], peer[metric]) for peer in block if peer.get(metric) is not None]
        if points:
            axes.plot(*zip(*points, strict=True), "x--", color=colour, label=program, markersize=6, linewidth=0.8)


def spread(rows: Sequence[Row], metric: str) -> list[tuple[float, float, float, float]]:
    """(seconds, mean, smallest, largest over seeds) of a metric at each budget."""
    found = []
    for budget in sorted({row["budget_s"] for row in rows}):
        values = [row[metric] for row in rows if row["budget_s"] == budget and row.get(metric) is not None]
        if values:
            found.append((budget, float(np.mean(values)), min(values), max(values)))
    return found


def front(points: Sequence[tuple[float, float]], *, higher: bool) -> list[tuple[float, float]]:
    """The (seconds, value) that no other point beats in at most the same time, by time."""
    edge: list[tuple[float, float]] = []
    for seconds, value in sorted(points, key=lambda point: (point[0], -point[1] if higher else point[1])):
        if not edge or (value > edge[-1][1] if higher else value < edge[-1][1]):
            edge.append((seconds, value))
    return edge


def parts(rows: Sequence[Sequence[Any]]) -> str:
    """Bars of the stages of a step, each divided by kernel; rows of stage, kernel, pass, milliseconds."""
    stages: dict[str, dict[str, float]] = {}
    for stage, kernel, _, milliseconds in rows:
        work = stages.setdefault(stage, {})
        work[kernel] = work.get(kernel, 0.0) + milliseconds
    order = sorted(stages, key=lambda stage: sum(stages[stage].values()))
    kernels = list(dict.fromkeys(kernel for _, kernel, _, _ in rows))
    figure = blank(9.5, 0.8 + 0.32 * len(order))
    axes = figure.add_subplot()
    left = np.zeros(len(order))
    for colour, kernel in zip(_colours(len(kernels)), kernels, strict=True):
        widths = np.array([stages[stage].get(kernel, 0.0) for stage in order])
        axes.barh(order, widths, left=left, color=colour, label=kernel)
        left += widths
    axes.set(xlabel="milliseconds")
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="lower right")
    _style(axes)
    return svg_of(figure)


def _colours(count: int) -> list[str]:
    return [COLOURS[index % len(COLOURS)] for index in range(max(count, 1))]


def _style(axes: Any) -> None:
    axes.grid(alpha=0.25)
    axes.title.set_fontsize(9.5)
    for text in (axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()):
        text.set_fontsize(8.5)
