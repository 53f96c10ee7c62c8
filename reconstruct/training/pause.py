"""A training gives way to somebody who moves about in its page: through a file in the run's folder, as the two are processes of their own.

RUN/moving.json    which share of the time the training may have, and until when
"""

import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from datasets.core import files

MOVING = "moving.json"
HOLD_S = 1.0
"""Somebody moves until so long after the last move."""
AGAIN_S = 0.3
"""The page says so no more often than this."""
NAP_S = 0.05
"""Between two looks of a training that waits."""


class Guest:
    """The page's side."""

    def __init__(self, run: Path) -> None:
        self._path = run / MOVING
        self._said = -AGAIN_S

    def moving(self, share: float) -> None:
        """Somebody moves now: the training may have this share of the time meanwhile, 0 to 1. 1 asks for nothing."""
        now = time.monotonic()
        if share >= 1 or now - self._said < AGAIN_S or not os.access(self._path.parent, os.W_OK):
            return
        self._said = now
        files.write_json(self._path, {"share": share, "until": time.time() + HOLD_S})


def wanted_share(run: Path) -> float:
    """Share of the time that a training may have now: 1 where nobody moves, or where the file is not one of ours."""
    path = run / MOVING
    try:
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        until, share = float(content.get("until", 0.0)), float(content.get("share", 1.0))
    except (OSError, ValueError, TypeError, AttributeError):
        return 1.0
    ahead = until - time.time()
    return min(max(share, 0.0), 1.0) if 0 < ahead <= HOLD_S else 1.0  # a clock that was set back must not stop a training


def give_way(run: Path, worked_s: float, *, until: Callable[[], bool] = lambda: False) -> float:
    """Rest after `worked_s` seconds of work so that the training has no more than its share; ends at once when nobody moves any more.

    Args:
        run: folder of the run.
        worked_s: time since the last call that the training has worked.
        until: asked often; ends the rest.

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
