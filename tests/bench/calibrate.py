"""Compare sessions that choose their views with the 25 fixed views, on simulated rigs: `capture calibrate` without pictures.

    python -m tests.bench.calibrate bench --rigs 50

prints views and time to the error of the fixed session, and whether stopped sessions keep what they state, and writes the same
to bench/bench.md with a figure, bench/bench.png.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sessions.calibrate.loop import reached
from koala3d.datasets.advice import Figures
from koala3d.datasets.core import files
from tests.bench.rehearsals import Rehearsal, Step, run

SHARE = 0.6  # of the fixed views: chosen views of this number are compared with all fixed ones


def _at(found: Sequence[Rehearsal], views: int) -> list[Step | None]:
    """The adaptive session of each rig after a number of views; None where it had ended."""
    return [next((step for step in one.adaptive if step.views == views), None) for one in found]


def as_good(steps: Sequence[Step], wanted: Figures | None) -> Step | None:
    """The first step from which on the expected errors stay at or below `wanted`; None: no such step."""
    found: Step | None = None
    for step in steps:
        good = wanted is not None and reached(step.spread, wanted)
        found = (found or step) if good else None
    return found


def summary(found: Sequence[Rehearsal], until: Figures) -> dict[str, Any]:
    """The figures of a benchmark."""
    fixed = [one.fixed[-1] for one in found]
    expected = [as_good(one.adaptive, last.spread) for one, last in zip(found, fixed, strict=True)]
    sixty = int(SHARE * fixed[0].views)
    pairs = [(step.truth, last.truth) for step, last in zip(_at(found, sixty), fixed, strict=True) if step]
    better = [sum(a[axis] <= b[axis] for a, b in pairs if a and b) for axis in (0, 1)]
    stopped = [one for one in found if one.stopped is not None]
    last = [one.adaptive[-1] for one in stopped]
    above_own = sum(not reached(step.truth, step.figures) for step in last if step.figures)
    above = sum(not reached(step.truth, until) for step in last)
    typical = _median([step.views if step else np.inf for step in expected])
    at = int(typical) if np.isfinite(typical) else 0
    same = [step.truth for step in _at(found, at) if step]
    return {
        "rigs": len(found),
        "fixed_views": fixed[0].views,
        "fixed_seconds": _median([step.seconds for step in fixed]),
        "fixed_rms": _rms([step.truth for step in fixed]),
        "fixed_expected": _rms([step.spread for step in fixed]),
        "fixed_above_stated": sum(not reached(step.truth, step.figures) for step in fixed if step.figures),
        "views_to_expected": typical,
        "views_share": _median([step.views / last.views if step else np.inf for step, last in zip(expected, fixed, strict=True)]),
        "views_share_worst": max(step.views / last.views if step else np.inf for step, last in zip(expected, fixed, strict=True)),
        "seconds_share": _median([step.seconds / f.seconds if step else np.inf for step, f in zip(expected, fixed, strict=True)]),
        "sixty_percent": sixty,
        "better_at_sixty_percent": better,
        "compared_at_sixty_percent": len(pairs),
        "adaptive_rms": _rms(same),
        "until": until,
        "stopped": len(stopped),
        "views_at_stop": _median([one.stopped for one in stopped if one.stopped is not None]),
        "above_wanted": above,
        "above_stated": above_own,
    }


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _rms(errors: Sequence[Figures | None]) -> Figures | None:
    known = np.array([one for one in errors if one is not None], np.float64).reshape(-1, 2)
    return (float(np.sqrt(np.mean(known[:, 0] ** 2))), float(np.sqrt(np.mean(known[:, 1] ** 2)))) if len(known) else None


def _words(errors: Figures | None) -> str:
    return "unknown" if errors is None else f"{errors[0]:.3f} mm, {errors[1]:.4f}°"


def describe(found: dict[str, Any]) -> str:
    """The figures in a table (Markdown)."""
    rigs, fixed = found["rigs"], found["fixed_views"]
    at, better = found["views_to_expected"], found["better_at_sixty_percent"]
    at_sixty = f"{better[0]} of {found['compared_at_sixty_percent']} in translation, {better[1]} in rotation"
    rows = [
        (f"views to the expected error of {fixed} fixed views, median", f"{at:.0f} ({found['views_share']:.0%})"),
        ("the same, worst rig", f"{found['views_share_worst']:.0%}"),
        ("time to it, median share", f"{found['seconds_share']:.0%} of {found['fixed_seconds']:.0f} s"),
        (f"rms of the true errors, {fixed} fixed views", _words(found["fixed_rms"])),
        (f"rms of the true errors, {at:.0f} chosen views", _words(found["adaptive_rms"])),
        (f"rigs whose {found['sixty_percent']} chosen views had the smaller true error than {fixed} fixed ones", at_sixty),
        ("sessions that stopped at {:g} mm, {:g}° with 95 %".format(*found["until"]), f"{found['stopped']} of {rigs}"),
        ("views at the stop, median", f"{found['views_at_stop']:.0f}"),
        ("of these, a true error above the wanted one", str(found["above_wanted"])),
        ("of these, a true error above the stated one", str(found["above_stated"])),
        ("fixed sessions with a true error above the stated one", str(found["fixed_above_stated"])),
    ]
    return "\n".join(["| " + f"{rigs} simulated rigs" + " | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)])


def write(out: Path, found: Sequence[Rehearsal], until: Figures) -> dict[str, Any]:
    """Write bench.md and bench.png into a new folder; returns the summary."""
    result = summary(found, until)
    files.make_folder(out)
    files.write_text(out / "bench.md", describe(result) + "\n")
    draw(out / "bench.png", found, until)
    return result


def draw(path: Path, found: Sequence[Rehearsal], until: Figures) -> None:
    """Stated limits and true errors against the number of views, for both kinds of session."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    picture = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(picture)
    for panel, (axis, unit) in enumerate((("translation", "mm"), ("rotation", "deg"))):
        axes = picture.add_subplot(1, 2, panel + 1)
        for name, colour in (("fixed", "tab:grey"), ("adaptive", "tab:blue")):
            views, stated, true = _curves(found, name, panel)
            axes.plot(views, stated, color=colour, label=f"{name}: stated, 95 %")
            axes.plot(views, true, color=colour, linestyle="--", marker=".", label=f"{name}: true, rms")
        axes.axhline(until[panel], color="tab:red", linewidth=0.8, label="wanted")
        axes.set(yscale="log", xlabel="views", ylabel=f"{axis} [{unit}]", title=f"error of the {axis}")
        axes.grid(alpha=0.3, which="both")
        if not panel:
            axes.legend(fontsize=8)
    with files.atomic_path(path) as temporary:
        picture.savefig(temporary, dpi=100, format="png")


def _curves(found: Sequence[Rehearsal], name: str, panel: int) -> tuple[NDArray[np.float64], ...]:
    """Numbers of views that every rig has; there the median of the stated limits, and the rms of the true errors."""
    steps = [{step.views: step for step in getattr(one, name) if step.figures and step.truth} for one in found]
    views = sorted(set.intersection(*(set(one) for one in steps)))
    stated = [np.median([one[n].figures[panel] for one in steps]) for n in views]
    true = [np.sqrt(np.mean([one[n].truth[panel] ** 2 for one in steps])) for n in views]
    return np.array(views, np.float64), np.array(stated), np.array(true)


def main() -> None:
    """Rehearse, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, metavar="FOLDER", help="new folder")
    parser.add_argument("--rigs", type=int, default=50, help="number of simulated rigs")
    parser.add_argument("--workers", type=int, default=2, help="rigs simulated at a time")
    parser.add_argument("--until", type=float, nargs=2, default=(0.06, 0.022), help="wanted errors [mm] [deg]")
    parser.add_argument("--json", action="store_true", help="print the figures for a program")
    asked = parser.parse_args()
    files.refuse_existing(asked.out)
    until = (asked.until[0], asked.until[1])
    found = write(asked.out, run(asked.rigs, asked.workers, until), until)
    print(json.dumps(found) if asked.json else describe(found))


if __name__ == "__main__":
    main()
