"""What happens when in a session: where the arm is at each time, and at which time each view is taken."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture import kinematics
from capture.errors import UnreachableError
from capture.planning import PlannedView, blocked, duration, move_duration, plan
from capture.trajectory import Trajectory
from capture.viewpoints import Viewpoint
from datasets.recording import Recording

WAIT_S = 1.0
"""Longest that an arm stands still in the playback of a recording, beside settling."""


@dataclass(frozen=True)
class Stop:
    """One view of a session."""

    name: str
    split: str
    base_from_camera: NDArray[np.float64]
    """(4, 4), by the nominal camera mount [m]."""
    seconds: float | None
    """When it is taken, from the start of the session; None where the arm cannot take it."""
    reason: str = ""
    """Why the arm cannot take it."""
    image: Path | None = None
    """Of a recording."""
    measured: str = ""
    """What a recording says of it: exposure and settling."""


@dataclass(frozen=True)
class Timeline:
    """Joint angles over time, straight between the knots."""

    seconds: NDArray[np.float64]
    """(n,) never falling, from 0; empty where the arm can take no view."""
    joints: NDArray[np.float64]
    """(n, 6) [rad]."""
    stops: tuple[Stop, ...]
    notes: tuple[str, ...] = ()

    @property
    def end(self) -> float:
        """Length of the session [s]."""
        return float(self.seconds[-1]) if len(self.seconds) else 0.0

    def at(self, seconds: float) -> NDArray[np.float64]:
        """(6,) joint angles [rad] at a time [s]."""
        return np.array([np.interp(seconds, self.seconds, angle) for angle in self.joints.T])

    def next_stop(self, seconds: float) -> Stop | None:
        """The view that is being taken at a time, or the next one after it."""
        later = [stop for stop in self.stops if stop.seconds is not None and stop.seconds >= seconds - 1e-6]
        return min(later, key=lambda stop: stop.seconds or 0.0, default=None)


def of_trajectory(trajectory: Trajectory, flange_from_camera: NDArray[np.float64]) -> Timeline:
    """The plan of a trajectory; views that the arm cannot take stand beside it with their reason.

    Raises:
        PlanningError: no way between two views was found.
    """
    reasons: dict[str, str] = {}
    try:
        planned = plan(trajectory, flange_from_camera)
    except UnreachableError:
        reasons = blocked(trajectory, flange_from_camera)
        left = len(trajectory.viewpoints()) - len(reasons)
        planned = plan(trajectory, flange_from_camera, without=reasons) if left else []
    timeline = of_planned(trajectory, planned, flange_from_camera)
    out_of_reach = [viewpoint for viewpoint in trajectory.viewpoints() if viewpoint.name in reasons]
    stops = [Stop(v.name, v.split, _wanted(v, flange_from_camera), None, reasons[v.name]) for v in out_of_reach]
    notes = (timeline.notes[0] + (f"; {len(reasons)} cannot be taken" if reasons else ""),)
    return replace(timeline, stops=(*timeline.stops, *stops), notes=notes)


def of_planned(trajectory: Trajectory, planned: list[PlannedView], flange_from_camera: NDArray[np.float64]) -> Timeline:
    """A plan that is there already."""
    seconds, joints, stops = [], [], []
    for view, arrivals in zip(planned, _arrivals(trajectory, planned), strict=True):
        seconds += arrivals
        joints += [corner for corner in view.way for _ in range(2)]
        base_from_camera = kinematics.forward(view.joints) @ flange_from_camera
        stops.append(Stop(view.viewpoint.name, view.viewpoint.split, base_from_camera, arrivals[-1]))
    notes = (f"{len(planned)} views in about {duration(trajectory, planned):.0f} s",)
    return Timeline(np.array(seconds), np.array(joints).reshape(-1, 6), tuple(stops), notes)


def _arrivals(trajectory: Trajectory, planned: list[PlannedView]) -> list[list[float]]:
    """For each view, when the arm arrives at each corner of its way and when it leaves it [s]; adds up to `duration`."""
    motion, now, previous, found = trajectory.motion, 0.0, None, []
    for view in planned:
        times: list[float] = []
        for corner in view.way:
            now += move_duration(motion, 0.0 if previous is None else float(np.abs(corner - previous).max()))
            times += [now, now + motion.settle_time_s]
            now, previous = times[-1], corner
        times[-1] = now = now + trajectory.camera.exposure_us * 1e-6 + 0.1
        found.append(times)
    return found


def _wanted(viewpoint: Viewpoint, flange_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    if viewpoint.base_from_camera is not None:
        return viewpoint.base_from_camera
    assert viewpoint.joints is not None  # a viewpoint has either
    return kinematics.forward(viewpoint.joints) @ flange_from_camera


def _without_waits(clock: NDArray[np.float64], joints: NDArray[np.float64], trajectory: Trajectory) -> NDArray[np.float64]:
    """(n,) times [s] at which views are shown: as on the clock, but no way takes longer than its motion, its settling and `WAIT_S`.

    An arm that waited for a person, or for a simulated camera's picture, would stand still for most of the playback.
    """
    swings = np.abs(np.diff(joints, axis=0)).max(-1, initial=0.0)
    longest = (
        np.array([move_duration(trajectory.motion, float(swing)) for swing in swings]) + trajectory.motion.settle_time_s + WAIT_S
    )
    return np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(clock), longest))])


def of_recording(recording: Recording, flange_from_camera: NDArray[np.float64]) -> Timeline:
    """What a recording has: where the controller said the arm was, at its own times. Between the views the way is drawn straight."""
    frames = sorted(recording.frames, key=lambda frame: frame.robot_time_s)
    if not frames:
        return Timeline(np.zeros(0), np.zeros((0, 6)), (), ("no views have been taken yet",))
    trajectory = Trajectory.model_validate(recording.trajectory)
    clock = np.array([frame.robot_time_s for frame in frames]) - frames[0].robot_time_s
    seconds = _without_waits(clock, np.stack([frame.joints for frame in frames]), trajectory)
    stops = tuple(
        Stop(frame.name, frame.split, frame.base_from_flange @ flange_from_camera, float(when), image=recording.image_path(frame),
             measured=f"exposed for {1e-3 * frame.exposure_us:g} ms, {frame.settle_s:.2f} s after the motion")
        for frame, when in zip(frames, seconds, strict=True)
    )  # fmt: skip
    waits = f", without {clock[-1] - seconds[-1]:.0f} s of waiting" if clock[-1] - seconds[-1] > WAIT_S else ""
    count = f"{len(frames)} of {len(trajectory.viewpoints())} views in {seconds[-1]:.0f} s{waits}"
    notes = (count, "between views the way is drawn straight")
    return Timeline(seconds, np.stack([frame.joints for frame in frames]), stops, notes)
