"""The recording of a session that chooses its own views: it grows by one view at a time, and keeps why each was taken.

The manifest's entry `chosen` holds the trajectory that said where the camera may be, for each view why it was taken, and why the
session ended.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.recording.growing import GrowingRecording, Use
from koala3d.capture.rig.rig import Rig
from koala3d.capture.sessions.adaptive.loop import CoverageOutcome, Known, Why
from koala3d.capture.sessions.adaptive.shape import Shape
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import validate
from koala3d.datasets.recording import CHOSEN, MANIFEST, Recording

Array = NDArray[np.float64]
COMMAND = "capture run --adaptive"


class ChosenRecording(GrowingRecording):
    """A rig and its recording; implements `capture.sessions.adaptive.loop.ViewTaker`."""

    def __init__(self, trajectory: Trajectory, rig: Rig, out: Path, shape: Shape) -> None:
        super().__init__(trajectory, rig, out, COMMAND)
        self.shape = shape
        self._reasons: dict[str, dict[str, Any]] = {}
        self._began = time.monotonic()

    def resume(self) -> None:
        """See `GrowingRecording.resume`; raises UsageError for another session."""
        if self.begun:
            self._reasons = dict(_chosen(Recording.open(self.out), self.trajectory)["views"])
        super().resume()

    @property
    def seconds(self) -> float:
        """Time since the rig was opened."""
        return time.monotonic() - self._began

    def choose(self, joints: Array, why: Why, use: Use = "train") -> None:
        """Record one view. Raises PlanningError, before anything moves or is written, if no path leads to it."""
        reasons = {**self._reasons, f"{self.taken:03d}": why.to_json()}
        self.take(joints, use=use, notes={CHOSEN: self._entry(reasons)})
        self._reasons = reasons

    def known(self) -> Known:
        """What the training views on the disk show."""
        return self.shape.known()

    def ended(self, outcome: CoverageOutcome, words: str) -> None:
        """Write why the session ended."""
        coverage = {"covered": outcome.coverage.covered, "reachable": outcome.coverage.reachable}
        end = {"reason": outcome.reason, "words": words, "shape": outcome.known.source, **coverage}
        self.note({CHOSEN: {**self._entry(self._reasons), "ended": end}})

    def _entry(self, reasons: dict[str, dict[str, Any]]) -> dict[str, Any]:
        return {"trajectory": self.trajectory.model_dump(mode="json"), "views": reasons}


def _chosen(recording: Recording, trajectory: Trajectory) -> dict[str, Any]:
    """What a recording says about its session. Raises UsageError where it is another one's."""
    content, where = recording.part(CHOSEN), recording.path / MANIFEST
    if not isinstance(content.get("views"), dict):
        remedy = "resume it with the command that made it, or choose another --out"
        raise UsageError(f"is no session of '{COMMAND}'", where=recording.path, remedy=remedy)
    if validate(content.get("trajectory") or {}, Trajectory, where=f"{where}, {CHOSEN}") != trajectory:
        remedy = "resume with the original arguments, or choose another --out"
        raise UsageError("was taken with another trajectory", where=recording.path, remedy=remedy)
    return content
