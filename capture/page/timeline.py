"""The timeline of a session: where the arm is at each time, and when each view is taken."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory, recorded_trajectory
from koala3d.capture.planning import PlannedView, arrivals, blocked, duration, plan
from koala3d.capture.planning.pace import paces
from koala3d.datasets.recording import Recording, chosen_views

WAIT_S = 1.0  # longest pause of the arm in the playback of a recording, in addition to settling


@dataclass(frozen=True)
class ShownView:
    """One view of a session."""

    name: str
    split: str
    base_from_camera: NDArray[np.float64]  # (4, 4) by the nominal camera mount [m]
    seconds: float | None  # time from the start of the session; None if the arm cannot take it
    reason: str = ""  # why the arm cannot take it
    image: Path | None = None  # the picture, in a recording
    measured: str = ""  # exposure and settling, in a recording


@dataclass(frozen=True)
class Timeline:
    """Joint angles over time, linear between the knots."""

    seconds: NDArray[np.float64]  # (n,) non-decreasing, from 0; empty if the arm can take no view
    joints: NDArray[np.float64]  # (n, joints) [rad]
    stops: tuple[ShownView, ...]
    notes: tuple[str, ...] = ()

    @property
    def end(self) -> float:
        """Length of the session [s]."""
        return float(self.seconds[-1]) if len(self.seconds) else 0.0

    def at(self, seconds: float) -> NDArray[np.float64]:
        """(joints,) angles [rad] at a time [s]."""
        return np.array([np.interp(seconds, self.seconds, angle) for angle in self.joints.T])

    def next_stop(self, seconds: float) -> ShownView | None:
        """The view that is taken at a time, or the next one."""
        later = [stop for stop in self.stops if stop.seconds is not None and stop.seconds >= seconds - 1e-6]
        return min(later, key=lambda stop: stop.seconds or 0.0, default=None)


def of_trajectory(trajectory: Trajectory, mount: Carrier) -> Timeline:
    """The plan of a trajectory. Views that the arm cannot take are included with the reason.

    Raises PlanningError: no path between two views was found.
    """
    reasons: dict[str, str] = {}
    try:
        planned = plan(trajectory, mount)
    except UnreachableError:
        reasons = blocked(trajectory, mount)
        left = len(trajectory.viewpoints()) - len(reasons)
        planned = plan(trajectory, mount, without=reasons) if left else []
    timeline = of_planned(trajectory, planned, mount)
    out_of_reach = [viewpoint for viewpoint in trajectory.viewpoints() if viewpoint.name in reasons]
    stops = [ShownView(v.name, v.split, v.camera_pose(mount), None, reasons[v.name]) for v in out_of_reach]
    notes = (timeline.notes[0] + (f"; {len(reasons)} cannot be taken" if reasons else ""),)
    return replace(timeline, stops=(*timeline.stops, *stops), notes=notes)


def of_planned(trajectory: Trajectory, planned: list[PlannedView], carrier: Carrier) -> Timeline:
    """An existing plan."""
    seconds, joints, stops = [], [], []
    for view, times in zip(planned, arrivals(trajectory, planned, carrier), strict=True):
        seconds += times
        joints += [corner for corner in view.path for _ in range(2)]
        base_from_camera = carrier.base_from_camera(view.joints)
        stops.append(ShownView(view.viewpoint.name, view.viewpoint.split, base_from_camera, times[-1]))
    notes = (f"{len(planned)} views in about {duration(trajectory, planned, carrier):.0f} s",)
    return Timeline(np.array(seconds), np.array(joints).reshape(-1, carrier.arm.count), tuple(stops), notes)


def _without_waits(
    clock: NDArray[np.float64], joints: NDArray[np.float64], trajectory: Trajectory, carrier: Carrier
) -> NDArray[np.float64]:
    """(n,) times [s] for the playback: those of the clock, with waits of at most `WAIT_S` after motion and settling.

    Otherwise an arm that waited for a person, or for a simulated picture, would stand still for most of the playback.
    """
    motion = trajectory.motion
    moves = [one.seconds for one in paces(list(joints), motion, carrier)]
    longest = np.array(moves) + motion.settle_time_s + WAIT_S
    return np.concatenate([[0.0], np.cumsum(np.minimum(np.diff(clock), longest))])


def of_recording(recording: Recording, carrier: Carrier) -> Timeline:
    """A recording: the joint angles and times that the controller reported. Paths between the views are drawn straight."""
    frames = sorted(recording.frames, key=lambda frame: frame.robot_time_s)
    if not frames:
        return Timeline(np.zeros(0), np.zeros((0, carrier.arm.count)), (), ("no views have been taken yet",))
    trajectory = recorded_trajectory(recording)
    clock = np.array([frame.robot_time_s for frame in frames]) - frames[0].robot_time_s
    seconds = _without_waits(clock, np.stack([frame.joints for frame in frames]), trajectory, carrier)
    stops, reasons = [], chosen_views(recording)
    for frame, when in zip(frames, seconds, strict=True):
        base_from_camera, image = carrier.camera_at(frame.base_from_flange), recording.image_path(frame)
        measured = f"exposed for {1e-3 * frame.exposure_us:g} ms, {frame.settle_s:.2f} s after the motion"
        if frame.turntable_angle is not None:
            measured += f", turntable at {np.degrees(frame.turntable_angle):.1f} degrees"
        if frame.name in reasons:
            measured += f"  \nwhy: {reasons[frame.name].get('words', '')}"
        stops.append(ShownView(frame.name, frame.split, base_from_camera, float(when), image=image, measured=measured))
    waits = f", without {clock[-1] - seconds[-1]:.0f} s of waiting" if clock[-1] - seconds[-1] > WAIT_S else ""
    count = f"{len(frames)} of {len(trajectory.viewpoints())} views in {seconds[-1]:.0f} s{waits}"
    notes = (count, "paths between views are drawn straight")
    return Timeline(seconds, np.stack([frame.joints for frame in frames]), tuple(stops), notes)
