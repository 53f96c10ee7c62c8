"""The benchmark's results as a table (CSV, Markdown) and a picture."""

import csv
import io
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.handeye import closed_forms
from koala3d.datasets.core import files
from tests.bench.handeye import BOUND, EXACT, REFINED, Errors, Point, Result
from tests.bench.ratios import Ratio

TIE = 1.005  # a thousand trials cannot distinguish methods whose errors differ by less than 0.5 %
ROUNDING = 1e-4  # an arm without error is stated as accurate to 1 um and 1e-4 degrees, which causes differences of this size
CLOSE = 1.10  # wanted ratio of the refinement's error to the bound
COLUMNS = "sigma_px arm_mm arm_deg views intrinsics trials method rms_mm rms_deg median_mm median_deg time_ms failures".split()


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """One row per point and method, as in the CSV file; the bound is a method of its own."""
    found = []
    for result in results:
        for name, errors in result.methods.items():
            (rms_mm, rms_deg), (median_mm, median_deg) = errors.rms, errors.median
            values = (name, rms_mm, rms_deg, median_mm, median_deg, _time(errors), errors.failures)
            found.append({**_place(result), **dict(zip(COLUMNS[6:], values, strict=True))})
        found.append({**_place(result), "method": BOUND, "rms_mm": result.bound[0], "rms_deg": result.bound[1]})
    return found


def _place(result: Result) -> dict[str, Any]:
    point = result.point
    intrinsics = "estimated" if point.free else "given"
    values = (point.sigma_px, point.arm_mm, point.arm_deg, point.views, intrinsics, result.trials)
    return dict(zip(COLUMNS, values, strict=False))


def _time(errors: Errors) -> float:
    return float(np.median(errors.time_ms)) if errors.time_ms else np.nan


def summary(results: Sequence[Result]) -> dict[str, Any]:
    """The benchmark as a whole: worst ratios of the refinement, and the number of points within the limits."""
    best, bound = (_table(results, kind) for kind in (Result.against_best, Result.against_bound))
    plain = np.array([result.plainly_against_bound() for result in results if max(result.methods[REFINED].rms) > EXACT[0]])
    return {
        "points": len(results),
        "trials": [min(r.trials for r in results), max(r.trials for r in results)],
        "failures_of_refinement": sum(r.methods[REFINED].failures for r in results),
        "at_or_below_best": int((best[..., 0] <= TIE).all(1).sum()),
        "worst_against_best": best[..., 0].max(0).tolist(),
        "surely_above_best": int((best[..., 1] > 1 + ROUNDING).any(1).sum()),
        "within_tenth_of_bound": int((bound[..., 0] <= CLOSE).all(1).sum()),
        "worst_against_bound": bound[..., 0].max(0).tolist(),
        "surely_within_tenth_of_bound": int((bound[..., 2] <= CLOSE).all(1).sum()),
        "worst_upper_end_against_bound": bound[..., 2].max(0).tolist(),
        "worst_plainly_against_bound": plain.max(0, initial=0.0).tolist(),
    }


def _table(results: Sequence[Result], kind: Callable[[Result], tuple[Ratio, Ratio]]) -> Array:
    """(points, 2, 3) value, low and high end of a ratio in translation and rotation."""
    return np.array([[(r.value, r.low, r.high) for r in kind(result)] for result in results])


def describe(results: Sequence[Result]) -> str:
    """`summary` in words."""
    s = summary(results)
    fewest, most = s["trials"]

    def pair(name: str) -> str:
        return f"{s[name][0]:.3f} in translation, {s[name][1]:.3f} in rotation"

    trials = fewest if fewest == most else f"{fewest} to {most}"
    return "\n".join(
        [
            f"{s['points']} points of {trials} trials, refinement failed {s['failures_of_refinement']} times",
            f"at or below the best closed form (within {TIE - 1:.1%}): {s['at_or_below_best']} points; "
            f"worst {pair('worst_against_best')}",
            f"above it by more than chance (95 % interval above 1): {s['surely_above_best']} points",
            f"within {CLOSE - 1:.0%} of the bound: {s['within_tenth_of_bound']} points; worst {pair('worst_against_bound')}",
            f"the whole 95 % interval within {CLOSE - 1:.0%}: {s['surely_within_tenth_of_bound']} points; "
            f"highest end {pair('worst_upper_end_against_bound')}",
            f"plain quotient of error and bound, which {fewest} trials leave uncertain by {(2 * fewest) ** -0.5:.0%}: "
            f"at most {pair('worst_plainly_against_bound')}",
        ]
    )


def markdown(results: Sequence[Result]) -> str:
    """A table with one row per point."""
    head = "corners [px]|arm [mm]|arm [°]|views|intrinsics|trials|best closed form: translation|rotation|refinement [mm]|[°]"
    head += "|bound [mm]|[°]|refinement / best|refinement / bound|time, closed forms to refinement [ms]"
    lines = [_row(head.split("|")), "|" + "---|" * 15]
    for result in results:
        p, refined = result.point, result.methods[REFINED]
        (first, second), best, bound = result.best, result.against_best(), result.against_bound()
        closed = [_time(result.methods[name]) for name in closed_forms.METHODS]
        noise, intrinsics = [f"{value:g}" for value in (p.sigma_px, p.arm_mm, p.arm_deg)], "estimated" if p.free else "given"
        forms = [f"{first} {result.methods[first].rms[0]:.4f}", f"{second} {result.methods[second].rms[1]:.4f}"]
        errors = [f"{value:.4f}" for value in (*refined.rms, *result.bound)]
        ratios = [f"{best[0]}, {best[1]}", f"{bound[0]}, {bound[1]}"]
        cells = [*noise, p.views, intrinsics, result.trials, *forms, *errors, *ratios]
        lines.append(_row([*cells, f"{min(closed):.1f}–{max(closed):.1f}, {_time(refined):.1f}"]))
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def write(folder: Path, results: Sequence[Result]) -> None:
    """Write bench.csv, bench.md and bench.png into a new folder."""
    with files.atomic_folder(folder) as temporary:
        text = io.StringIO()
        writer: csv.DictWriter[str] = csv.DictWriter(text, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows(results))
        files.write_text(temporary / "bench.csv", text.getvalue())
        files.write_text(temporary / "bench.md", f"{describe(results)}\n\n{markdown(results)}")
        _plot(temporary / "bench.png", results)


def _plot(path: Path, results: Sequence[Result]) -> None:
    """Above: error against run time at three noise levels, a line per method along the number of views. Below: all ratios."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 12), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(3, 3)
    for column, level in enumerate(_levels(results)):
        chosen = [r for r in results if _level(r.point) == level]
        for axis, unit in enumerate(("mm", "°")):
            _error_against_time(grid[axis][column], chosen, axis, unit)
        along = "\nintrinsics estimated" if level[3] else ""
        grid[0][column].set_title(f"corners {level[0]:g} px, arm {level[1]:g} mm, {level[2]:g}°{along}")
    grid[0][0].legend(fontsize=8, ncols=2)
    for axis, kind in enumerate(("translation", "rotation")):
        _draw_ratios(grid[2][axis], results, axis, kind)
    grid[2][2].axis("off")
    words = "\n\n".join(textwrap.fill(line, 60) for line in describe(results).splitlines())
    text = grid[2][2].text(0, 0.5, words, va="center", fontsize=9)
    text.set_in_layout(False)  # else it takes its width from the other pictures
    figure.savefig(path, dpi=100)


def _level(point: Point) -> tuple[float, float, float, bool]:
    return point.sigma_px, point.arm_mm, point.arm_deg, bool(point.free)


def _levels(results: Sequence[Result]) -> list[tuple[float, float, float, bool]]:
    """Up to three noise levels worth a picture: the Koala rig's with intrinsics given and estimated, and a poor rig's."""
    present = list(dict.fromkeys(_level(r.point) for r in results))
    wanted = [(0.1, 0.03, 0.005, False), (0.1, 0.03, 0.005, True), (1.0, 1.0, 0.1, False)]
    return ([level for level in wanted if level in present] + [level for level in present if level not in wanted])[:3]


def _error_against_time(axes: Any, results: Sequence[Result], axis: int, unit: str) -> None:
    for name in (*closed_forms.METHODS, REFINED):
        error = [r.methods[name].rms[axis] for r in results]
        time = [_time(r.methods[name]) for r in results]
        style = {"color": "black", "linewidth": 2, "zorder": 5} if name == REFINED else {"alpha": 0.8}
        axes.plot(time, error, marker="o", markersize=4, label=name, **style)
        if name == REFINED:
            for x, y, r in zip(time, error, results, strict=True):
                axes.annotate(f"{r.point.views} views", (x, y), textcoords="offset points", xytext=(6, 3), fontsize=8)
    for r in results:
        axes.axhline(r.bound[axis], color="grey", linestyle=":", linewidth=1)
    axes.plot([], [], color="grey", linestyle=":", label="bound at each number of views")
    axes.set(xscale="log", yscale="log", xlabel="run time [ms]", ylabel=f"rms error [{unit}]")
    for direction in (axes.xaxis, axes.yaxis):
        direction.set_major_formatter("{x:g}")
        direction.set_minor_formatter(lambda value, place: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")


def _draw_ratios(axes: Any, results: Sequence[Result], axis: int, kind: str) -> None:
    """Both ratios of all points; that to the bound with its interval."""
    places, best = np.arange(len(results)), _table(results, Result.against_best)[:, axis]
    value, low, high = _table(results, Result.against_bound)[:, axis].T
    axes.plot(places, best[:, 0], "o", markersize=4, label="refinement / best closed form")
    axes.errorbar(places, value, [value - low, high - value], fmt="k.", elinewidth=1, label=f"refinement / {BOUND}, 95 %")
    axes.axhline(1.0, color="grey", linewidth=1)
    axes.axhline(CLOSE, color="grey", linestyle="--", linewidth=1)
    axes.set(ylim=(0, 1.3), xlabel="point of the benchmark", ylabel="ratio of rms errors", title=kind)
    axes.legend(fontsize=8, loc="lower right")
