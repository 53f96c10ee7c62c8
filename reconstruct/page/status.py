"""What the page of a run says of its training: how far it is, how good, what it left out."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import uplot

from reconstruct.run import CHECKPOINTS, LOG, Run
from reconstruct.training import checkpoint
from reconstruct.training.skipping import record

QUIET_S = 300.0
"""Without news for so long, a training has been stopped."""


def is_training(run: Run) -> bool:
    """Whether a run is neither at its end nor without news for `QUIET_S`."""
    log = run.log()
    news = [path.stat().st_mtime for path in (run.path / LOG, *checkpoint.steps(run.path / CHECKPOINTS)) if path.exists()]
    ended = bool(log) and log[-1].get("progress", 0.0) >= 1
    return not ended and bool(news) and time.time() - max(news) < QUIET_S


def status_text(log: list[dict[str, Any]], run: Run) -> str:
    """Markdown on how far a training is and what it left out."""
    if not log:
        return "*no line in the log yet*"
    last = log[-1]
    known = {"training rays": "psnr_train", "unseen": "psnr_unseen"}
    quality = ", ".join(f"{name} {last[key]:.2f} dB" for name, key in known.items() if key in last)
    lines = [f"step {last['step']} after {last['seconds']:.0f} s ({100 * last['progress']:.0f} %): {quality}"]
    if last["skipped"]:
        lines.append(f"{last['skipped']} steps left out because their gradient was not finite")
    if "occupied" in last:
        lines.append(f"{100 * last['occupied']:.0f} % of the space holds anything; the rest is left out")
    return "  \n".join([*lines, *(f"*{note}*" for note in run.content.get("notes", []))])


def curves(log: list[dict[str, Any]]) -> tuple[tuple[NDArray[np.float64], ...], tuple[uplot.Series, ...]]:
    """PSNR [dB] on training rays and unseen pixels over the seconds of training: columns, and how to draw them."""
    columns = [np.array([line.get(key, np.nan) for line in log], np.float64) for key in ("seconds", "psnr_train", "psnr_unseen")]
    series = (uplot.Series(label="seconds"), uplot.Series(label="training rays [dB]", stroke="#d98324", width=1.5),
              uplot.Series(label="unseen [dB]", stroke="#2f6fde", width=2))  # fmt: skip
    return tuple(columns), series


def skips_text(run: Run) -> str:
    """Markdown on what the training left out, with evidence, saving and price, and on what it kept and why; empty where it has no list."""
    skips = record.read(run.path)
    left_out = [f"- **{record.in_words(skip.name)}** left out: {skip.evidence}  \n  *saves {skip.saving}; price: {skip.cost}*"
                for skip in skips if skip.skipped]  # fmt: skip
    return "\n".join(
        [*left_out, *(f"- {record.in_words(skip.name)} kept: {skip.evidence}" for skip in skips if not skip.skipped)]
    )
