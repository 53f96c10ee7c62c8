"""The page of a trajectory, a finished recording, or a recording in progress.

A trajectory is planned, so that each view shows whether the arm can take it. A complete recording is played by the clock of the
controller. For an incomplete recording the plan is shown, and frames are added as they arrive.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.rig import RigDescription, recorded_carrier
from koala3d.capture.model.trajectory import Trajectory, load_trajectory, recorded_trajectory
from koala3d.capture.page.live import LiveView
from koala3d.capture.page.session import CaptureView
from koala3d.capture.page.timeline import of_planned, of_recording, of_trajectory
from koala3d.capture.planning import PlannedView
from koala3d.datasets.page import Page
from koala3d.datasets.recording import Recording


def show(page: Page, path: Path, description: RigDescription, *, overrides: list[str] | None = None) -> dict[str, Any]:
    """Show a trajectory or a recording on a page; returns a summary for the command.

    Args:
        path: folder of a recording, or file or name of a trajectory.
        description: rig whose arm and camera a trajectory is planned with. A recording has its own.
        overrides: changes to the trajectory, such as "camera.binning=4".

    Raises:
        UsageError: `path` is neither a trajectory nor a recording.
        PlanningError: no path between two views was found.
    """
    if Path(path).is_dir():
        recording = Recording.open(path)
        trajectory = recorded_trajectory(recording)
        mount = recorded_carrier(recording)
        complete = len(recording.frames) == len(trajectory.viewpoints())
        timeline = of_recording(recording, mount) if complete else of_trajectory(trajectory, mount)
    else:
        complete = True
        trajectory, mount = load_trajectory(path, overrides=overrides), description.carrier()
        timeline = of_trajectory(trajectory, mount)
    shown = CaptureView(page, trajectory, mount, timeline)
    page.in_background(shown.add_thumbnails if complete else LiveView(shown, Path(path), mount).follow)
    taken = sum(stop.seconds is not None for stop in timeline.stops)
    return {"name": trajectory.name, "views": taken, "blocked": len(timeline.stops) - taken, "seconds": round(timeline.end, 1)}


def watch(
    page: Page, path: Path, trajectory: Trajectory, mount: Carrier, planned: list[PlannedView], *, stop: Callable[[], None]
) -> None:
    """Show a recording on a page while it is made. The stop button calls `stop`; `mount`: the arm and its camera."""
    shown = CaptureView(page, trajectory, mount, of_planned(trajectory, planned, mount))
    live = LiveView(shown, path, mount)
    live.offer_stop(stop)
    page.in_background(live.follow)
