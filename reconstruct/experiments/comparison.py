"""Differences between two sweeps that exceed the noise of repeated seeds.

For each figure and place (scene, model, setting, preset, budget), the seeds of both sweeps are compared by Welch's two-sided
t-test (1947): a difference counts if its 95 % confidence interval excludes zero. One in twenty comparisons of equal sweeps is
a false alarm, so the number of tests is reported as well. A paired t-test of each figure's mean difference over all places
reveals changes that are too small for any single place. Fewer than two seeds cannot be tested.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from koala3d.reconstruct.experiments.results import Row
from koala3d.reconstruct.experiments.statistics import CONFIDENCE, Change, paired, welch
from koala3d.reconstruct.output.metric_names import HIGHER_IS_BETTER

NORMALS = ("normal_mae_deg", "normal_mae_alpha_acc_deg", "normal_pred_mae_deg", "normal_pred_mae_alpha_acc_deg")
COSTS = ("rays_per_s", "seconds", "compilation_s", "peak_memory_mb")
COMPARED = ("psnr", "ssim", "psnr_inside", "ssim_inside", *NORMALS, "depth_rmse_mm", "chamfer_mm", *COSTS)
BETTER_HIGH = HIGHER_IS_BETTER | {"rays_per_s", "samples_per_s"}
EVERYWHERE = "all places"


@dataclass(frozen=True)
class Difference:
    """A figure in one place, or its mean over all places."""

    place: str
    figure: str
    before: float
    after: float
    change: Change

    @property
    def verdict(self) -> str:
        """ "better", "worse", "noise" or "unknown"."""
        if not np.isfinite(self.change.p):
            return "unknown"
        if self.change.p >= 1 - CONFIDENCE:
            return "noise"
        return "better" if (self.change.value > 0) == (self.figure in BETTER_HIGH) else "worse"


def compare(before: Sequence[Row], after: Sequence[Row], figures: Sequence[str] = COMPARED) -> list[Difference]:
    """All figures in all places that both sweeps contain, and the means over these places."""
    first, second = ({f"{row.scene}, {row.origin}": row for row in rows} for rows in (before, after))
    found = []
    for figure in figures:
        pairs = []
        for place in (place for place in first if place in second):
            a, b = first[place].sample(figure), second[place].sample(figure)
            if a is not None and b is not None:
                found.append(Difference(place, figure, a.mean, b.mean, welch(a, b)))
                pairs.append((a.mean, b.mean))
        if len(pairs) > 1:
            mean_before, mean_after = np.mean(pairs, 0).tolist()
            found.append(Difference(EVERYWHERE, figure, mean_before, mean_after, paired(np.array(pairs))))
    return sorted(found, key=lambda one: (one.place != EVERYWHERE, one.place))


def summary(differences: Sequence[Difference]) -> dict[str, Any]:
    """All differences, and the expected number of false alarms."""
    tested = sum(np.isfinite(one.change.p) for one in differences)
    return {
        "test": "Welch's t-test over seeds; paired t-test over places",
        "confidence": CONFIDENCE,
        "tested": tested,
        "expected_false_alarms": round((1 - CONFIDENCE) * tested, 2),
        "differences": [_content(one) for one in differences],
    }


def _content(one: Difference) -> dict[str, Any]:
    interval = {name: value if np.isfinite(value) else None for name, value in asdict(one.change).items() if name != "value"}
    return {
        "place": one.place,
        "figure": one.figure,
        "before": one.before,
        "after": one.after,
        **interval,
        "verdict": one.verdict,
    }


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
        lines.append(f"{unknown} cannot be tested: a sweep has fewer than two seeds")
    return "\n".join(lines)


def _line(one: Difference, width: int) -> str:
    shown: Callable[[float], str] = lambda value: f"{value:.4g}"  # noqa: E731
    interval = f" ({shown(one.change.low)} to {shown(one.change.high)})" if np.isfinite(one.change.low) else ""
    values = f"{shown(one.before):>10} -> {shown(one.after):<10}{one.change.value:+.4g}{interval}"
    return f"{one.verdict:<8}{one.place:<{width}}  {one.figure:<30}{values}".rstrip()
