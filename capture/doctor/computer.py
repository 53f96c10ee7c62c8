"""Checks of the computer: free disk, clock, and the network between it and the controller."""

import os
import shutil
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from koala3d.capture.doctor.lines import Line, judged, unknown, wrong
from koala3d.capture.doctor.report import ControllerReport
from koala3d.datasets.core.budgets import readable

EARLIEST = datetime(2026, 1, 1, tzinfo=UTC)  # no clock that is right shows an earlier time than that of this program
DRIFT = 1e-3  # of the controller's clock against ours; both are quartz, good to 1e-4


def check(
    answers: ControllerReport, folder: Path, *, needed: float, now: datetime, longest_gap_s: float, rate: float | None
) -> list[Line]:
    """The lines.

    Args:
        folder: where the recording will be; need not exist.
        needed: bytes that it takes.
        longest_gap_s: between two samples, before the driver takes the stream for dead.
        rate: of the controller's clock; None: not known, as in a simulation.
    """
    clock = f"{now:%Y-%m-%d %H:%M} UTC"
    return [
        _disk(folder.absolute(), needed),
        judged("clock", now > EARLIEST, clock, "set the computer's clock; times in recordings come from it", blocks=False),
        *_network(answers, longest_gap_s, rate),
    ]


def _disk(folder: Path, needed: float) -> Line:
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not (there.is_dir() and os.access(there, os.W_OK)):
        why = "is not a folder" if not there.is_dir() else "cannot be written"
        return wrong("free disk", f"{there} {why}", "choose another --out")
    free = shutil.disk_usage(there).free
    room = f"{readable(free)} free, {readable(needed)} needed"
    return judged("free disk", free > needed, room, "free some space, or write to another disk")


def _network(answers: ControllerReport, longest_gap_s: float, rate: float | None) -> list[Line]:
    if len(answers.arrivals) < 2:
        return [unknown(name, "no samples", "enable RTDE at the pendant") for name in ("network", "controller clock")]
    ours, theirs = answers.arrivals.T
    gaps = np.diff(ours)
    worst, usual = float(gaps.max()), float(np.median(gaps))
    found = f"{len(gaps)} samples in {ours[-1] - ours[0]:.1f} s, gaps {1e3 * usual:.0f} ms, longest {1e3 * worst:.0f} ms"
    remedy = "a cable without a switch in between, no WLAN, no other load on this computer"
    network = judged("network", worst < longest_gap_s, found, remedy, blocks=False)
    span, late = float(ours[-2] - ours[0]), 2 * worst
    if rate is None or span < 0.2:
        return [network]
    ratio = float(theirs[-2] - theirs[0]) / span / rate
    good = abs(ratio - 1) < DRIFT + late / span  # both ends may be late by a gap
    return [network, judged("controller clock", good, f"{ratio:.4f} of ours", "restart the controller", blocks=False)]
