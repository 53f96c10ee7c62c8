"""The page of a trajectory, of a recording, or of one that is being made.

A trajectory is planned anew, so that each view shows whether the arm can take it; a complete recording is played by the controller's
clock; of one that is not complete, the plan is shown and filled in as frames come.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.page.live import LiveView
from capture.page.session import CaptureView
from capture.page.timeline import of_planned, of_recording, of_trajectory
from capture.planning import PlannedView
from capture.rig.description import RigDescription
from capture.trajectory import Trajectory, load_trajectory
from datasets.page import Page
from datasets.recording import Recording

Array = NDArray[np.float64]


def show(page: Page, path: Path, description: RigDescription, *, overrides: list[str] | None = None) -> dict[str, Any]:
    """Put a trajectory file, or the recording in a folder, on a page; returns what the command says of it.

    Args:
        page: to draw on.
        path: file or folder.
        description: of the rig whose camera mount a trajectory is planned with; a recording brings its own.
        overrides: changes of the trajectory, "camera.binning=4".

    Raises:
        UsageError: neither a trajectory nor a recording.
        PlanningError: no way between two views was found.
    """
    if Path(path).is_dir():
        recording = Recording.open(path)
        trajectory = Trajectory.model_validate(recording.trajectory)
        mount = RigDescription.model_validate(own_rig(recording)).flange_from_camera.matrix()
        complete = len(recording.frames) == len(trajectory.viewpoints())
        timeline = of_recording(recording, mount) if complete else of_trajectory(trajectory, mount)
    else:
        complete = True
        trajectory, mount = load_trajectory(path, overrides=overrides), description.flange_from_camera.matrix()
        timeline = of_trajectory(trajectory, mount)
    shown = CaptureView(page, trajectory, mount, timeline)
    page.in_background(shown.add_thumbnails if complete else LiveView(shown, Path(path), mount).follow)
    taken = sum(stop.seconds is not None for stop in timeline.stops)
    return {"name": trajectory.name, "views": taken, "blocked": len(timeline.stops) - taken, "seconds": round(timeline.end, 1)}


def watch(
    page: Page,
    path: Path,
    trajectory: Trajectory,
    flange_from_camera: Array,
    planned: list[PlannedView],
    *,
    stop: Callable[[], None],
) -> None:
    """Put a recording that is about to be made on a page.

    Args:
        page: to draw on.
        path: where the recording will be.
        trajectory: what is taken.
        flange_from_camera: (4, 4) nominal mount [m].
        planned: its plan.
        stop: called by the button that stops the arm.
    """
    shown = CaptureView(page, trajectory, flange_from_camera, of_planned(trajectory, planned, flange_from_camera))
    live = LiveView(shown, path, flange_from_camera)
    live.offer_stop(stop)
    page.in_background(live.follow)


def own_rig(recording: Recording) -> dict[str, Any]:
    """The rig that a recording was made with, as its file described it; the nominal one where nothing is said."""
    return {key: value for key, value in recording.manifest.get("rig", {}).items() if key in RigDescription.model_fields}
