"""The rig of a calibration session: its recording grows by one view at a time, and its adviser reads every view on the disk."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.recording.growing import GrowingRecording
from koala3d.capture.rig.rig import Rig
from koala3d.capture.sessions.calibrate.adviser import Adviser
from koala3d.datasets.advice import Answer, Question

Array = NDArray[np.float64]


class AdvisedRig:
    """A rig, its recording, and the adviser who reads it; implements `capture.sessions.calibrate.loop.BoardViewTaker`.

    Args:
        trajectory: settings of camera, motion and safety, and the target. Its own views only say where the camera may be.
        out: the recording; a new or empty folder unless it is resumed.
    """

    def __init__(self, trajectory: Trajectory, rig: Rig, out: Path, adviser: Adviser) -> None:
        self.recording, self.adviser = GrowingRecording(trajectory, rig, out, "capture calibrate"), adviser

    def resume(self) -> None:
        """Continue the recording in the folder, see `GrowingRecording.resume`."""
        self.recording.resume()

    @property
    def taken(self) -> int:
        """Number of views so far."""
        return self.recording.taken

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        return self.recording.joints()

    def take(self, joints: Array) -> None:
        """Record one view. Raises PlanningError, before anything moves or is written, where no path leads to it."""
        self.recording.take(joints)

    def ask(self, question: Question) -> Answer:
        """Ask the adviser, who reads every view on the disk."""
        return self.adviser.ask(question)
