"""A recording whose trajectory grows by one view at a time. Each view is in the manifest before the arm moves to it.

So a kill at any moment loses no view: what is on the disk stays, and a view that was chosen and not taken is taken on resuming.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.calibrating.adviser import Adviser
from capture.planning import Obstacles, PlannedView, connect
from capture.recording.recorder import record
from capture.rig.opening import Rig
from capture.trajectory import Trajectory, recorded_trajectory
from capture.viewpoints import JointViews
from datasets.advice import Answer, Question
from datasets.core import files
from datasets.core.errors import UsageError
from datasets.recording import MANIFEST, Recording

Array = NDArray[np.float64]


class GrowingRecording:
    """A rig, its recording, and the adviser who reads it; implements `capture.calibrating.loop.Arm`.

    Args:
        trajectory: settings of camera, motion and safety, and the target. Its own views only say where the camera may be.
        out: the recording; a new or empty folder unless it is resumed.
    """

    def __init__(self, trajectory: Trajectory, rig: Rig, out: Path, adviser: Adviser) -> None:
        self.trajectory, self.rig, self.out, self.adviser = trajectory, rig, Path(out), adviser
        self._obstacles = Obstacles.of(trajectory, rig.carrier)
        self._views: list[list[float]] = []  # joint angles [deg]
        self._resumed = False

    def resume(self) -> None:
        """Continue the recording in the folder: take the views that were chosen and are missing.

        Raises UsageError where the recording is another kind of session, and what `record` raises.
        """
        self._resumed = True
        if not (self.out / MANIFEST).is_file():
            return
        views = recorded_trajectory(Recording.open(self.out)).views
        if len(views) != 1 or not isinstance(views[0], JointViews):
            remedy = "resume it with 'capture run --resume', or choose another --out"
            raise UsageError("is no session of 'capture calibrate'", where=self.out, remedy=remedy)
        self._views = list(views[0].joints_deg)
        self._record(resume=True)

    @property
    def taken(self) -> int:
        """Number of views so far."""
        return len(self._views)

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        return self.rig.robot.state().joints

    def take(self, joints: Array) -> None:
        """Record one view. Raises PlanningError, before anything moves or is written, where no path leads to it."""
        degrees = np.degrees(joints).tolist()
        connect(self.joints(), np.radians(degrees), self._obstacles, where=f"view {self.taken:03d}")
        self._views.append(degrees)
        if resume := (self.out / MANIFEST).is_file():
            recording = Recording.open(self.out)
            files.write_json(self.out / MANIFEST, {**recording.manifest, "trajectory": self._grown().model_dump(mode="json")})
        self._record(resume=resume)

    def ask(self, question: Question) -> Answer:
        """Ask the adviser, who reads every view on the disk."""
        return self.adviser.ask(question)

    def _grown(self) -> Trajectory:
        views = [JointViews(kind="joints", joints_deg=self._views)]
        return self.trajectory.model_copy(update={"views": views, "split": None})

    def _record(self, *, resume: bool) -> None:
        grown = self._grown()
        views = [view for view in grown.viewpoints() if view.joints is not None]  # all are given by their joints
        planned = [PlannedView(view, view.joints, [view.joints]) for view in views if view.joints is not None]
        record(grown, self.rig, self.out, resume=resume or self._resumed, planned=planned)
