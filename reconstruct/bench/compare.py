"""Which differences between two benchmarks exceed what another seed would have made.

For each figure of each place (scene, model, preset, budget) the seeds of both sides are compared by Welch's t-test (1947), two-sided: a
difference counts where its interval of 95 % confidence leaves out zero. Of twenty comparisons without any difference one will seem to have
one, so that their number is told too. Over all places together, each figure's mean difference is tested by a paired t-test: small
changes that no single place can show are seen there. A side with fewer than two seeds cannot be tested.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruct.bench.records import Row, latest
from reconstruct.bench.suite import QUALITY
from reconstruct.output.metric_names import HIGHER_IS_BETTER
from reconstruct.studies import seeds
from reconstruct.studies.seeds import CONFIDENCE, Sample

PLACE = ("scene", "scale", "model", "preset", "budget_s")
FIGURES = ("psnr", "ssim", "normal_mae_deg", "normal_mae_alpha_acc_deg", "normal_pred_mae_deg", "normal_pred_mae_alpha_acc_deg",
           "depth_rmse_mm", "chamfer_mm", "rays_per_s", "seconds", "compilation_s", "peak_memory_mb")  # fmt: skip
"""What is compared."""
BETTER_HIGH = frozenset(HIGHER_IS_BETTER) | {"rays_per_s", "samples_per_s"}
EVERYWHERE = "all places"


@dataclass(frozen=True)
class Difference:
    """One figure at one place, or its mean over all of them."""

    place: str
    figure: str
    before: float
    after: float
    low: float
    """Lower end of the interval of the difference, after - before."""
    high: float
    p: float
    """Probability of at least such a difference by chance alone; NaN where it cannot be known."""
    count: tuple[int, int]
    """Seeds of each side; places, for the mean over all."""

    @property
    def change(self) -> float:
        """after - before."""
        return self.after - self.before

    @property
    def verdict(self) -> str:
        """ "better", "worse", "noise" or "unknown"."""
        if not np.isfinite(self.p):
            return "unknown"
        if self.p >= 1 - CONFIDENCE:
            return "noise"
        return "better" if (self.change > 0) == (self.figure in BETTER_HIGH) else "worse"


def compare(before: Sequence[Row], after: Sequence[Row], figures: Sequence[str] = FIGURES) -> list[Difference]:
    """All figures at all places that both sides have, and their means over all places."""
    first, second = (_by_place(rows) for rows in (before, after))
    shared = [place for place in first if place in second]
    found = []
    for figure in figures:
        pairs = []
        for place in shared:
            a, b = (_values(side[place], figure) for side in (first, second))
            if len(a) and len(b):
                found.append(welch(place, figure, a, b))
                pairs.append((a.mean(), b.mean()))
        if len(pairs) > 1:
            found.append(paired(figure, np.array(pairs)))
    return sorted(found, key=lambda one: (one.place != EVERYWHERE, one.place))


def _by_place(rows: Sequence[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in latest(rows):
        if row["kind"] == QUALITY:
            found.setdefault(place_of(row), []).append(row)
    return found


def place_of(row: Row) -> str:
    """What is compared with its like, in words."""
    scale = "" if row["scale"] == 1 else f" at {row['scale']:g}"
    return f"{row['scene']}{scale}, {row['model']} {row['preset']}, {row['budget_s']:g} s"


def _values(rows: Sequence[Row], figure: str) -> np.ndarray:
    return np.array([row[figure] for row in rows if row.get(figure) is not None], np.float64)


def welch(place: str, figure: str, before: np.ndarray, after: np.ndarray) -> Difference:
    """Two small samples whose spreads may differ."""
    first, second = Sample.of(before), Sample.of(after)
    change = seeds.welch(first, second)
    return Difference(place, figure, first.mean, second.mean, change.low, change.high, change.p, (first.count, second.count))


def paired(figure: str, pairs: np.ndarray) -> Difference:
    """Paired t-test of (n, 2) means of places."""
    sample = Sample.of(pairs[:, 1] - pairs[:, 0])
    change = seeds.tested(sample.mean, float(sample.deviation / np.sqrt(sample.count)), sample.count - 1)
    before, after = pairs.mean(0)
    return Difference(
        EVERYWHERE, figure, float(before), float(after), change.low, change.high, change.p, (sample.count, sample.count)
    )


def summary(differences: Sequence[Difference]) -> dict[str, Any]:
    """Everything for a program, and how many false alarms are to be expected."""
    tested = sum(np.isfinite(one.p) for one in differences)
    rows = [{"place": one.place, "figure": one.figure, "before": one.before, "after": one.after, "low": _known(one.low),
             "high": _known(one.high), "p": _known(one.p), "verdict": one.verdict} for one in differences]  # fmt: skip
    return {"test": "Welch's t-test over seeds; paired t-test over places", "confidence": CONFIDENCE, "tested": tested,
            "expected_false_alarms": round((1 - CONFIDENCE) * tested, 2), "differences": rows}  # fmt: skip


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def text(differences: Sequence[Difference], *, everything: bool = False) -> str:
    """The differences that exceed the noise, a line each; with `everything` the others too."""
    told = summary(differences)
    chosen = [one for one in differences if everything or one.verdict in ("better", "worse")]
    width = max((len(one.place) for one in chosen), default=0)
    lines = [_line(one, width) for one in chosen]
    unknown = sum(one.verdict == "unknown" for one in differences)
    lines.append(f"{len(chosen) if not everything else sum(o.verdict in ('better', 'worse') for o in differences)} of {told['tested']} differences exceed "
                 f"the noise of seeds ({100 * CONFIDENCE:.0f} % confidence: {told['expected_false_alarms']:g} would by chance)")  # fmt: skip
    if unknown:
        lines.append(f"{unknown} cannot be tested: fewer than two seeds on a side")
    return "\n".join(lines)


def _line(one: Difference, width: int) -> str:
    shown: Callable[[float], str] = lambda value: f"{value:.4g}"  # noqa: E731
    interval = f" ({shown(one.low)} to {shown(one.high)})" if np.isfinite(one.low) else ""
    return (f"{one.verdict:<8}{one.place:<{width}}  {one.figure:<30}{shown(one.before):>10} -> {shown(one.after):<10}"
            f"{one.change:+.4g}{interval}").rstrip()  # fmt: skip
