"""Status of a training on the page of its run: progress, quality, skips."""

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import uplot

from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.run import CHECKPOINTS, LOG, Run
from koala3d.reconstruct.training.decisions import record

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
    known = {"training rays": "psnr_train", "test views": "psnr_unseen"}
    quality = ", ".join(f"{name} {last[key]:.2f} dB" for name, key in known.items() if key in last)
    lines = [f"step {last['step']} after {last['seconds']:.0f} s ({100 * last['progress']:.0f} %): {quality}"]
    if last["skipped"]:
        lines.append(f"{last['skipped']} steps skipped because their gradient was not finite")
    if "occupied" in last:
        lines.append(f"{100 * last['occupied']:.0f} % of the space is occupied; the rest is skipped")
    return "  \n".join([*lines, *(f"*{note}*" for note in run.content.get("notes", []))])


def curves(log: list[dict[str, Any]]) -> tuple[tuple[NDArray[np.float64], ...], tuple[uplot.Series, ...]]:
    """PSNR [dB] on training rays and test views over the seconds of training: columns, and their styles."""
    columns = [np.array([line.get(key, np.nan) for line in log], np.float64) for key in ("seconds", "psnr_train", "psnr_unseen")]
    train = uplot.Series(label="training rays [dB]", stroke="#d98324", width=1.5)
    unseen = uplot.Series(label="test views [dB]", stroke="#2f6fde", width=2)
    return tuple(columns), (uplot.Series(label="seconds"), train, unseen)


def skips_text(run: Run) -> str:
    """Skips of a training as Markdown, with evidence and saving, then what was kept and why; empty without a list."""
    skips = record.read(run.path)
    lines = [
        f"- **{skip.what}** skipped: {skip.evidence}" + (f"  \n  *saves {skip.saving}*" if skip.saving else "")
        for skip in skips
        if skip.skipped
    ]
    return "\n".join([*lines, *(f"- {skip.what} kept: {skip.evidence}" for skip in skips if not skip.skipped)])
