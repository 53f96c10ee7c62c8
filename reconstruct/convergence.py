"""Whether a training converges, from the lines of its log; its beginning is enough."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from koala3d.datasets.core.console import hint
from koala3d.datasets.core.findings import Finding

EARLY_S = 30.0
"""Seconds of training from which a verdict is given."""
HOPELESS_DB, STANDSTILL_DB = 15.0, 0.3
"""PSNR below which, and gain over the second half of the log below which, a training does not converge."""
OVERFIT_DB, FAR_DB, LOST_DB = 3.0, 6.0, 1.0
"""Training rays are over-fitted where they are better than unseen views by the second, or by the first while unseen views
lost the third since their best."""
FALL_DB = 2.0
"""PSNR lost since its best from which a training diverges."""
WORSE_DB = 0.3
"""PSNR of unseen views lost since its best from which a training got worse; the spread of the log is a third of that."""
FEWEST_LINES = 4


def find(log: Sequence[dict[str, Any]], *, until_s: float | None = None) -> list[Finding]:
    """Findings on the lines of a log (`Run.log`), of all or of the first `until_s` seconds."""
    lines = [line for line in log if until_s is None or line["seconds"] <= until_s]
    train = np.array([line["psnr_train"] for line in lines if "psnr_train" in line])
    unseen = np.array([line["psnr_unseen"] for line in lines if "psnr_unseen" in line])
    if len(train) < FEWEST_LINES:
        return []
    smooth = np.array([np.median(train[max(0, k - 1) : k + 2]) for k in range(len(train))])
    figures = {"seconds": lines[-1]["seconds"], "psnr_train": float(smooth[-1])}
    where = f"the first {lines[-1]['seconds']:.0f} s"
    best, last, half = float(smooth.max()), float(smooth[-1]), float(smooth[len(smooth) // 2])
    if last < best - FALL_DB:
        why = f"training rays had {best:.1f} dB and fell to {last:.1f} dB"
        return [_finding("training diverges", where, why, "lower the rate: --set train.rate=0.003", figures)]
    if last < HOPELESS_DB and last - half < STANDSTILL_DB:
        why = f"training rays stand still at {last:.1f} dB"
        return [_finding("training does not converge", where, why, "check poses and intrinsics: datasets check", figures)]
    if len(unseen) >= FEWEST_LINES:
        behind = float(np.median(train[-3:]) - np.median(unseen[-3:]))
        falls = float(unseen.max() - np.median(unseen[-3:]))
        if behind > FAR_DB or (behind > OVERFIT_DB and falls > LOST_DB):
            why = f"unseen views are {behind:.1f} dB behind training rays and lost {falls:.1f} dB since their best"
            remedy = "take more views, or look for exposure and poses that differ between views"
            return [_finding("training over-fits", where, why, remedy, {**figures, "behind_db": behind})]
    return []


def got_worse(log: Sequence[dict[str, Any]]) -> list[Finding]:
    """A finding if unseen views were better in the midst of a training than at its end."""
    lines = [line for line in log if "psnr_unseen" in line]
    if len(lines) < FEWEST_LINES:
        return []
    unseen = np.array([line["psnr_unseen"] for line in lines])
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(unseen, 3), -1)
    best, last = int(smooth.argmax()), float(smooth[-1])
    if smooth[best] - last <= WORSE_DB:
        return []
    why = f"they had {smooth[best]:.1f} dB after {lines[best + 1]['step']} steps and {last:.1f} dB at the end"
    figures = {"best_db": float(smooth[best]), "last_db": last}
    return [_finding("unseen views got worse", "the whole training", why, "try another seed: --set train.seed=1", figures)]


def _finding(what: str, where: str, why: str, remedy: str, figures: dict[str, float]) -> Finding:
    return Finding("warning", what, where, why, remedy, "training", figures)


def early_warning(log: Sequence[dict[str, Any]]) -> str | None:
    """One line for the person who waits, when the last line is the first after `EARLY_S` seconds; None where all is well."""
    if not log or not (log[-1]["seconds"] >= EARLY_S > max((line["seconds"] for line in log[:-1]), default=0.0)):
        return None
    found = find(log)
    return found[0].line if found else None


def warn_early(log: Sequence[dict[str, Any]]) -> None:
    """Show the early warning, if there is one."""
    if words := early_warning(log):
        hint(words)


def figures_of(line: dict[str, Any]) -> str:
    """The figures of a line of the log that are shown beside the progress."""
    known = {"PSNR": "psnr_train", "unseen": "psnr_unseen"}
    return ", ".join(f"{name} {line[key]:.1f} dB" for name, key in known.items() if key in line)
