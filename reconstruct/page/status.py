"""Status of a training on the page of its run: progress, quality, skips."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import uplot

from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.run import CHECKPOINTS, LOG, Run
from koala3d.reconstruct.training.skipping import record

QUIET_S = 300.0  # a training without output for this long counts as stopped


def is_training(run: Run) -> bool:
    """Whether a run is unfinished and has written something within `QUIET_S`."""
    log = run.log()
    news = [path.stat().st_mtime for path in (run.path / LOG, *checkpoint.steps(run.path / CHECKPOINTS)) if path.exists()]
    ended = bool(log) and log[-1].get("progress", 0.0) >= 1
    return not ended and bool(news) and time.time() - max(news) < QUIET_S


def status_text(log: list[dict[str, Any]], run: Run) -> str:
    """Progress and quality of a training as Markdown."""
    if not log:
        return "*the log is empty*"
    last = log[-1]
    known = {"training rays": "psnr_train", "held-out pixels": "psnr_unseen"}
    quality = ", ".join(f"{name} {last[key]:.2f} dB" for name, key in known.items() if key in last)
    lines = [f"step {last['step']} after {last['seconds']:.0f} s ({100 * last['progress']:.0f} %): {quality}"]
    if last["skipped"]:
        lines.append(f"{last['skipped']} steps skipped because their gradient was not finite")
    if "occupied" in last:
        lines.append(f"{100 * last['occupied']:.0f} % of the space is occupied; the rest is skipped")
    return "  \n".join([*lines, *(f"*{note}*" for note in run.content.get("notes", []))])


def curves(log: list[dict[str, Any]]) -> tuple[tuple[NDArray[np.float64], ...], tuple[uplot.Series, ...]]:
    """PSNR [dB] on training rays and held-out pixels over the seconds of training: columns, and their styles."""
    columns = [np.array([line.get(key, np.nan) for line in log], np.float64) for key in ("seconds", "psnr_train", "psnr_unseen")]
    train = uplot.Series(label="training rays [dB]", stroke="#d98324", width=1.5)
    held_out = uplot.Series(label="held-out pixels [dB]", stroke="#2f6fde", width=2)
    return tuple(columns), (uplot.Series(label="seconds"), train, held_out)


def skips_text(run: Run) -> str:
    """Skips of a training as Markdown, with evidence, saving and cost, then what was kept and why; empty without a list."""
    skips = record.read(run.path)
    words = {skip.name: record.in_words(skip.name) for skip in skips}
    cost = "- **{}** skipped: {}  \n  *saves {}; cost: {}*"
    lines = [cost.format(words[skip.name], skip.evidence, skip.saving, skip.cost) for skip in skips if skip.skipped]
    return "\n".join([*lines, *(f"- {words[skip.name]} kept: {skip.evidence}" for skip in skips if not skip.skipped)])
