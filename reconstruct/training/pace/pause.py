"""A training slows down while somebody navigates in its page. The two processes share a file in the run's folder.

RUN/moving.json    share of the time that the training may use, and until when
"""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from koala3d.datasets.core import files

MOVING = "moving.json"
HOLD_S = 1.0
"""A request holds for this long after the last movement."""
AGAIN_S = 0.3
"""Shortest time between two requests of the page."""
NAP_S = 0.05
"""Time between two checks of a training that waits."""


class PauseRequests:
    """The page's side."""

    def __init__(self, run: Path) -> None:
        self._path = run / MOVING
        self._last = -AGAIN_S

    def request(self, share: float) -> None:
        """Ask the training to use only this share of the time for a while, 0 to 1. 1 asks for nothing."""
        now = time.monotonic()
        if share >= 1 or now - self._last < AGAIN_S or not os.access(self._path.parent, os.W_OK):
            return
        self._last = now
        files.write_json(self._path, {"share": share, "until": time.time() + HOLD_S})


def wanted_share(run: Path) -> float:
    """Share of the time that a training may use now: 1 without a valid request."""
    path = run / MOVING
    try:
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        until, share = float(content.get("until", 0.0)), float(content.get("share", 1.0))
    except (OSError, ValueError, TypeError, AttributeError):
        return 1.0
    ahead = until - time.time()
    return min(max(share, 0.0), 1.0) if 0 < ahead <= HOLD_S else 1.0  # a clock that was set back must not stop a training


def give_way(run: Path, worked_s: float, *, until: Callable[[], bool] = lambda: False) -> float:
    """Rest after `worked_s` seconds of work, so that the training uses no more than its share; ends when the request does.

    Args:
        run: folder of the run.
        worked_s: how long the training has worked since the last call.
        until: ends the rest when it becomes true.

    Returns:
        Seconds of rest.
    """
    start = time.monotonic()
    while (share := wanted_share(run)) < 1 and not until():
        rested = time.monotonic() - start
        if share > 0 and rested >= worked_s * (1 - share) / share:
            break
        time.sleep(NAP_S)
    return time.monotonic() - start
