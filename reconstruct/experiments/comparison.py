"""Differences between two benchmarks that exceed the noise of repeated seeds.

For each metric and setup (scene, model, preset, budget), the seeds of both benchmarks are compared by Welch's two-sided
t-test (1947): a difference counts if its 95 % confidence interval excludes zero. One in twenty comparisons of equal
benchmarks is a false alarm, so the number of tests is reported as well. A paired t-test of each metric's mean difference
over all setups reveals changes that are too small for any single setup. A benchmark with fewer than two seeds cannot be
tested.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from koala3d.reconstruct.bench.records import Row, latest
from koala3d.reconstruct.bench.suite import QUALITY
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER
from koala3d.reconstruct.studies import seeds
from koala3d.reconstruct.studies.seeds import CONFIDENCE, Sample

NORMALS = ("normal_mae_deg", "normal_mae_alpha_acc_deg", "normal_pred_mae_deg", "normal_pred_mae_alpha_acc_deg")
COSTS = ("rays_per_s", "seconds", "compilation_s", "peak_memory_mb")
COMPARED = ("psnr", "ssim", "psnr_inside", "ssim_inside", *NORMALS, "depth_rmse_mm", "chamfer_mm", *COSTS)
BETTER_HIGH = HIGHER_IS_BETTER | {"rays_per_s", "samples_per_s"}
EVERYWHERE = "all places"


@dataclass(frozen=True)
class Difference:
    """A metric in one setup, or its mean over all setups."""

    place: str
    figure: str
    before: float
    after: float
    low: float  # lower end of the confidence interval of after - before
    high: float
    p: float  # p-value; NaN if it is unknown
    count: tuple[int, int]  # number of seeds of each benchmark; of setups, for the mean over all

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


def compare(before: Sequence[Row], after: Sequence[Row], metrics: Sequence[str] = COMPARED) -> list[Difference]:
    """All metrics in all setups that both benchmarks contain, and the means over these setups."""
    first, second = (_by_setup(rows) for rows in (before, after))
    shared = [place for place in first if place in second]
    found = []
    for metric in metrics:
        pairs = []
        for place in shared:
            a, b = (_values(side[place], metric) for side in (first, second))
            if len(a) and len(b):
                found.append(welch(place, metric, a, b))
                pairs.append((a.mean(), b.mean()))
        if len(pairs) > 1:
            found.append(paired(metric, np.array(pairs)))
    return sorted(found, key=lambda one: (one.place != EVERYWHERE, one.place))


def _by_setup(rows: Sequence[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in latest(rows):
        if row["kind"] == QUALITY:
            found.setdefault(setup_of(row), []).append(row)
    return found


def setup_of(row: Row) -> str:
    """Name of the setup of a trial."""
    scale = "" if row["scale"] == 1 else f" at {row['scale']:g}"
    return f"{row['scene']}{scale}, {row['model']} {row['preset']}, {row['budget_s']:g} s"


def _values(rows: Sequence[Row], figure: str) -> np.ndarray:
    return np.array([row[figure] for row in rows if row.get(figure) is not None], np.float64)


def welch(place: str, figure: str, before: np.ndarray, after: np.ndarray) -> Difference:
    """Welch's t-test of two samples."""
    first, second = Sample.of(before), Sample.of(after)
    change = seeds.welch(first, second)
    return Difference(place, figure, first.mean, second.mean, change.low, change.high, change.p, (first.count, second.count))


def paired(figure: str, pairs: np.ndarray) -> Difference:
    """Paired t-test of the (n, 2) means of setups."""
    sample = Sample.of(pairs[:, 1] - pairs[:, 0])
    change = seeds.tested(sample.mean, float(sample.deviation / np.sqrt(sample.count)), sample.count - 1)
    (before, after), counts = pairs.mean(0).tolist(), (sample.count, sample.count)
    return Difference(EVERYWHERE, figure, before, after, change.low, change.high, change.p, counts)


def summary(differences: Sequence[Difference]) -> dict[str, Any]:
    """All differences, and the expected number of false alarms."""
    tested = sum(np.isfinite(one.p) for one in differences)
    kept = ("place", "figure", "before", "after", "low", "high", "p", "verdict")
    return {
        "test": "Welch's t-test over seeds; paired t-test over places",
        "confidence": CONFIDENCE,
        "tested": tested,
        "expected_false_alarms": round((1 - CONFIDENCE) * tested, 2),
        "differences": [{name: _known(getattr(one, name)) for name in kept} for one in differences],
    }


def _known(value: str | float) -> str | float | None:
    return value if isinstance(value, str) or np.isfinite(value) else None


def text(differences: Sequence[Difference], *, everything: bool = False) -> str:
    """The differences that exceed the noise, a line each; with `everything` all of them."""
    counts = summary(differences)
    chosen = [one for one in differences if everything or one.verdict in ("better", "worse")]
    width = max((len(one.place) for one in chosen), default=0)
    lines = [_line(one, width) for one in chosen]
    unknown = sum(one.verdict == "unknown" for one in differences)
    clear = sum(one.verdict in ("better", "worse") for one in differences)
    chance = f"{100 * CONFIDENCE:.0f} % confidence; {counts['expected_false_alarms']:g} expected by chance"
    lines.append(f"{clear} of {counts['tested']} differences exceed the noise of seeds ({chance})")
    if unknown:
        lines.append(f"{unknown} cannot be tested: a benchmark has fewer than two seeds")
    return "\n".join(lines)


def _line(one: Difference, width: int) -> str:
    shown: Callable[[float], str] = lambda value: f"{value:.4g}"  # noqa: E731
    interval = f" ({shown(one.low)} to {shown(one.high)})" if np.isfinite(one.low) else ""
    values = f"{shown(one.before):>10} -> {shown(one.after):<10}{one.change:+.4g}{interval}"
    return f"{one.verdict:<8}{one.place:<{width}}  {one.figure:<30}{values}".rstrip()
