"""The page's drawings, as SVG in colours that are read on light and on dark ground."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from reconstruct.bench.records import Row
from reconstruct.output import metric_names
from reconstruct.output.metric_names import HIGHER_IS_BETTER

FIGURES = ("psnr", "normal_mae_alpha_acc_deg", "depth_rmse_mm", "chamfer_mm")
"""A panel each, where there is anything to draw."""
COLOURS = ("#2f6fde", "#d98324", "#3a9d5d", "#b3479a", "#8a8f2b", "#c74545", "#4aa3b5", "#7a5cc7")
GREY = "#808080"


def pareto(rows: Sequence[Row], peers: Sequence[Row] = ()) -> str:
    """Error against seconds: a line per model and preset, other programs as crosses, and the front of them all."""
    figures = [name for name in FIGURES if any(row.get(name) is not None for row in rows)] or list(FIGURES[:1])
    drawing = _figure(3.3 * len(figures) + 0.4, 3.2)
    lines = {
        name: [row for row in rows if (row["model"], row["preset"]) == name]
        for name in dict.fromkeys((r["model"], r["preset"]) for r in rows)
    }
    for panel, figure in enumerate(figures):
        axes = drawing.add_subplot(1, len(figures), panel + 1, facecolor="none")
        reached = []
        for colour, (name, block) in zip(_colours(len(lines)), lines.items(), strict=False):
            points = spread(block, figure)
            if points:
                seconds, mean, low, high = np.array(points).T
                axes.errorbar(
                    seconds,
                    mean,
                    np.maximum([mean - low, high - mean], 0),
                    color=colour,
                    label=" ".join(name),
                    marker="o",
                    markersize=3.5,
                    capsize=2,
                    linewidth=1.4,
                )
                reached += list(zip(seconds, mean, strict=True))
        for colour, (program, block) in zip(reversed(COLOURS), _programs(peers).items(), strict=False):
            points = [(peer["seconds"], peer[figure]) for peer in block if peer.get(figure) is not None]
            if points:
                axes.plot(*zip(*points, strict=True), "x--", color=colour, label=program, markersize=6, linewidth=0.8)
        if len(edge := front(reached, higher=figure in HIGHER_IS_BETTER)) > 1:
            axes.plot(*zip(*edge, strict=True), color=GREY, linewidth=5, alpha=0.22, zorder=0, solid_capstyle="round")
        axes.set_xscale("log")
        ticks = sorted({row["budget_s"] for row in rows})
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlabel="seconds of training", title=metric_names.column_heading(figure))
        _grey(axes)
        if panel == 0:
            axes.legend(frameon=False, fontsize=8, labelcolor=GREY)
    return _svg(drawing)


def spread(rows: Sequence[Row], figure: str) -> list[tuple[float, float, float, float]]:
    """(seconds, mean, smallest, largest over seeds) of a figure at each budget."""
    found = []
    for budget in sorted({row["budget_s"] for row in rows}):
        values = [row[figure] for row in rows if row["budget_s"] == budget and row.get(figure) is not None]
        if values:
            found.append((budget, float(np.mean(values)), min(values), max(values)))
    return found


def front(points: Sequence[tuple[float, float]], *, higher: bool) -> list[tuple[float, float]]:
    """Those (seconds, figure) that nothing beats in less time or in as much, by time."""
    edge: list[tuple[float, float]] = []
    for seconds, value in sorted(points, key=lambda point: (point[0], -point[1] if higher else point[1])):
        if not edge or (value > edge[-1][1] if higher else value < edge[-1][1]):
            edge.append((seconds, value))
    return edge


def parts(rows: Sequence[Sequence[Any]]) -> str:
    """Bars of the stages of a step, each divided by the work in it; rows of stage, kernel, pass, milliseconds."""
    stages: dict[str, dict[str, float]] = {}
    for stage, kernel, _, milliseconds in rows:
        work = stages.setdefault(stage, {})
        work[kernel] = work.get(kernel, 0.0) + milliseconds
    order = sorted(stages, key=lambda stage: sum(stages[stage].values()))
    kernels = list(dict.fromkeys(kernel for _, kernel, _, _ in rows))
    drawing = _figure(9.5, 0.8 + 0.32 * len(order))
    axes = drawing.add_subplot(facecolor="none")
    left = np.zeros(len(order))
    for colour, kernel in zip(_colours(len(kernels)), kernels, strict=True):
        widths = np.array([stages[stage].get(kernel, 0.0) for stage in order])
        axes.barh(order, widths, left=left, color=colour, label=kernel)
        left += widths
    axes.set(xlabel="milliseconds")
    axes.legend(frameon=False, fontsize=8, labelcolor=GREY, ncols=2, loc="lower right")
    _grey(axes)
    return _svg(drawing)


def _programs(peers: Sequence[Row]) -> dict[str, list[Row]]:
    return {
        name: [peer for peer in peers if peer["program"] == name] for name in dict.fromkeys(peer["program"] for peer in peers)
    }


def _colours(count: int) -> list[str]:
    return [COLOURS[index % len(COLOURS)] for index in range(max(count, 1))]


def _figure(width: float, height: float):
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor="none")


def _grey(axes: Any) -> None:
    """Text and lines of the frame in a colour for any ground."""
    axes.grid(alpha=0.25)
    axes.title.set_fontsize(9.5)
    for part in (axes.title, axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()):
        part.set_color(GREY)
        part.set_fontsize(8.5)
    for line in (*axes.spines.values(), *axes.xaxis.get_ticklines(), *axes.yaxis.get_ticklines()):
        line.set_color(GREY)


def _svg(drawing: Any) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.StringIO()
    FigureCanvasSVG(drawing).print_svg(buffer, metadata={"Date": None})
    return buffer.getvalue()[buffer.getvalue().index("<svg") :]
