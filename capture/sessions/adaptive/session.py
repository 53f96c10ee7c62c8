"""One session of `capture run --adaptive`, from the rig's opening to its end, and what it shows."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import Obstacles
from koala3d.capture.sessions.adaptive import loop
from koala3d.capture.sessions.adaptive.candidates import COUNT, dense, within_reach
from koala3d.capture.sessions.adaptive.gain import ENOUGH, Coverage
from koala3d.capture.sessions.adaptive.loop import CandidateViews, CoverageGoal, CoverageOutcome, Why
from koala3d.capture.sessions.adaptive.recording import ChosenRecording
from koala3d.capture.sessions.adaptive.shape import Shape, eye_of
from koala3d.capture.sessions.adaptive.tour import TourView, tour
from koala3d.capture.sessions.preview import show_reach
from koala3d.capture.sessions.start import SessionOptions
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core import console
from koala3d.datasets.core.errors import UsageError

Show = Callable[[int, Why, Coverage | None], None]


def run(
    trajectory: Trajectory, out: Path, goal: CoverageGoal, options: SessionOptions, calibration: Calibration | None, show: Show
) -> CoverageOutcome:
    """Record a session.

    Args:
        calibration: of camera and mount; None: the object's box stands for its shape.
        show: called after each view with the number of views, why it was taken, and the coverage once views are chosen by it.

    Raises UsageError: `out` holds something else, or the trajectory is of another kind. CaptureError: an error of the rig; the
    arm stands still, and `out` can be resumed.
    """
    check(trajectory)
    with options.opened(trajectory, out) as rig:
        eye = eye_of(rig.flange_from_camera, calibration)
        recording = ChosenRecording(trajectory, rig, out, Shape(trajectory, out, eye, calibration))
        obstacles = recording.obstacles
        reach = CandidateViews(_reachable(trajectory, obstacles), obstacles, eye)
        first, lost = tour(trajectory, obstacles.carrier)
        if lost:
            console.hint(f"{lost} test views of the trajectory cannot be taken and are left out")
        show_reach(recording, np.concatenate([one.solutions.joints[:1] for one in reach.candidates]))
        if options.resume:
            recording.resume()
        _tour(recording, first, goal, show)
        outcome = loop.run(reach, recording, goal, trajectory.motion, show=show)
        recording.ended(outcome, loop.REASONS[outcome.reason])
        return outcome


def check(trajectory: Trajectory) -> None:
    """Raise UsageError where views of a trajectory cannot be chosen."""
    if trajectory.target is not None:
        raise UsageError("looks at a calibration target", where=trajectory.name, remedy="use 'capture calibrate'")
    if trajectory.turns:
        remedy = "leave --adaptive out, or use a trajectory without 'turntable'"
        raise UsageError("a session that chooses its views turns no turntable", where=trajectory.name, remedy=remedy)


def _reachable(trajectory: Trajectory, obstacles: Obstacles) -> list[loop.ReachableView]:
    viewpoints = dense(trajectory, COUNT)
    with console.progress("planning", len(viewpoints), "views") as bar:
        found, reasons = within_reach(viewpoints, obstacles, bar.advance)
    if not found:
        remedy = "see 'capture plan'"
        raise UnreachableError("no view within reach", where=trajectory.name, why=reasons[0] if reasons else "", remedy=remedy)
    console.hint(f"{len(found)} of {len(viewpoints)} views can be taken and are chosen from")
    return found


def _tour(recording: ChosenRecording, first: list[TourView], goal: CoverageGoal, show: Show) -> None:
    """Take the first views that are missing."""
    for view in first[recording.taken :]:
        if recording.taken >= (goal.views or len(first)) or (goal.minutes and recording.seconds >= 60 * goal.minutes):
            return
        why = Why("first" if view.use == "train" else "test")
        recording.choose(view.joints, why, view.use)
        show(recording.taken, why, None)


def show(views: int, why: Why, coverage: Coverage | None) -> None:
    """Print why a view was taken, and the coverage after it."""
    after = "" if coverage is None else f"; {100 * coverage.covered:.1f} % covered"
    console.hint(f"view {views - 1:03d}: {why.words}{after}")


def describe(out: Path, outcome: CoverageOutcome, views: int, seconds: float) -> str:
    """The outcome in a few lines."""
    coverage = outcome.coverage
    lines = [f"{out}: {views} views in {seconds:.0f} s", f"ended: {loop.REASONS[outcome.reason]}"]
    lines.append(
        f"covered: {100 * coverage.covered:.1f} % of the surface within reach, by {ENOUGH} training views at 60 degrees or less "
        f"(shape: {outcome.known.source})"
    )
    if coverage.reachable < 0.995:
        lines.append(
            f"out of reach: {100 * (1 - coverage.reachable):.1f} % of the surface; a wider elevation_deg or azimuth_deg of the "
            "trajectory may show more of it"
        )
    return "\n".join(lines)


def facts(out: Path, outcome: CoverageOutcome, views: int, seconds: float) -> dict[str, Any]:
    """The outcome for a program."""
    coverage = {"covered": outcome.coverage.covered, "reachable": outcome.coverage.reachable}
    found = {"recording": str(out), "frames": views, "seconds": round(seconds, 2)}
    return {**found, "ended": outcome.reason, **coverage, "shape": outcome.known.source}
