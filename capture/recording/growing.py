"""A recording whose trajectory grows by one view at a time. Each view is in the manifest before the arm moves to it.

So a kill at any moment loses no view: what is on the disk stays, and a view that was chosen and not taken is taken on resuming.
"""

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.model.viewpoints import JointViews
from koala3d.capture.planning import Obstacles, PlannedView, connect
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.incidents import left_out
from koala3d.datasets.recording import MANIFEST, Recording

Array = NDArray[np.float64]
Use = Literal["train", "test"] | None


@dataclass(frozen=True)
class GrownView:
    """One view that was chosen."""

    joints_deg: list[float]
    use: Use = None
    """None: what the views of the trajectory are for, such as calibration."""


class GrowingRecording:
    """A rig and its recording.

    Args:
        trajectory: settings of camera, motion and safety. Its own views only say where the camera may be.
        out: the recording; a new or empty folder unless it is resumed.
        command: what makes such recordings, for messages.

    Raises UsageError: the rig has several cameras, or the trajectory switches lamps.
    """

    def __init__(self, trajectory: Trajectory, rig: Rig, out: Path, command: str) -> None:
        if rig.cameras:
            why, remedy = f"the rig has {len(rig.cameras)}", "use 'capture run TRAJECTORY', or a rig file of one of them"
            raise UsageError("chooses its views for one camera", where=command, why=why, remedy=remedy)
        if trajectory.switches:
            remedy = "leave 'lamps' out of its views"
            raise UsageError("a session that chooses its views switches no lamps", where=trajectory.name, remedy=remedy)
        self.trajectory, self.rig, self.out, self.command = trajectory, rig, Path(out), command
        self.views: list[GrownView] = []
        self.obstacles = Obstacles.of(trajectory, rig.carrier)
        self._resumed = False
        self._left_out: set[str] = set()  # by this run; a resumed one tries them again

    @property
    def begun(self) -> bool:
        """Whether the recording is on the disk."""
        return (self.out / MANIFEST).is_file()

    def resume(self) -> None:
        """Continue the recording in the folder: take the views that were chosen and are missing.

        Raises UsageError where the recording is another kind of session, and what `record` raises.
        """
        self._resumed = True
        if not self.begun:
            return
        groups = recorded_trajectory(Recording.open(self.out)).views
        if not all(isinstance(group, JointViews) for group in groups):
            remedy = "resume it with the command that made it, or choose another --out"
            raise UsageError(f"is no session of '{self.command}'", where=self.out, remedy=remedy)
        self.views = [
            GrownView(joints, group.use) for group in groups if isinstance(group, JointViews) for joints in group.joints_deg
        ]
        self._record(self.rig, resume=True)

    @property
    def taken(self) -> int:
        """Number of views so far."""
        return len(self.views)

    def joints(self) -> Array:
        """(n,) present joint angles [rad]."""
        return self.rig.robot.state().joints

    def take(self, joints: Array, *, use: Use = None, notes: dict[str, Any] | None = None) -> None:
        """Record one view.

        Args:
            notes: entries of the manifest to write with the view, before the arm moves.

        Raises PlanningError, before anything moves or is written, where no path leads to it.
        """
        notes, degrees = notes or {}, np.degrees(joints).tolist()
        connect(self.joints(), np.radians(degrees), self.obstacles, where=f"view {self.taken:03d}")
        self.views.append(GrownView(degrees, use))
        if begun := self.begun:
            self.note({"trajectory": self._grown().model_dump(mode="json"), **notes})
        self._record(replace(self.rig, extra={**self.rig.extra, **notes}), resume=begun)

    def note(self, notes: dict[str, Any]) -> None:
        """Write entries of the manifest."""
        files.write_json(self.out / MANIFEST, {**Recording.open(self.out).manifest, **notes})

    def _grown(self) -> Trajectory:
        groups = [list(group) for _, group in itertools.groupby(self.views, key=lambda view: view.use)]
        views = [JointViews(kind="joints", use=one[0].use, joints_deg=[view.joints_deg for view in one]) for one in groups]
        return self.trajectory.model_copy(update={"views": views, "split": None})

    def _record(self, rig: Rig, *, resume: bool) -> None:
        grown = self._grown()
        planned = [one for one in self._planned(grown, resume) if one.viewpoint.name not in self._left_out]
        self._left_out.update(left_out(record(grown, rig, self.out, resume=resume or self._resumed, planned=planned)))

    def _planned(self, grown: Trajectory, resume: bool) -> list[PlannedView]:
        """All views. The recorder finds a path to the first that is missing; those to others that follow it are found here."""
        taken = {frame.name for frame in Recording.open(self.out).frames} if resume else set()
        planned: list[PlannedView] = []
        for view in grown.viewpoints():
            assert view.joints is not None  # all are given by their joints
            path = [view.joints]
            if planned and not {view.name, planned[-1].viewpoint.name} & taken:
                path = connect(planned[-1].joints, view.joints, self.obstacles, where=f"view {view.name}")
            planned.append(PlannedView(view, view.joints, path))
        return planned
