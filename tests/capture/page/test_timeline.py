"""The session over time: what is played back is what is planned, or what was recorded."""

from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.model import kinematics
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.page.timeline import WAIT_S, of_recording, of_trajectory
from koala3d.capture.planning import Pace, duration, plan
from koala3d.datasets.recording import Frame, Recording

MOUNT = RigDescription().carrier()


def trajectory(x: float = 0.4, count: int = 8) -> Trajectory:
    view = {"kind": "orbit", "target": [x, 0.0, 0.14], "distance": 0.4, "elevation_deg": 40, "count": count}
    views = [view | {"roll_deg": [0, 90, 180, 270]}]
    return Trajectory.model_validate({"name": "ring", "views": views, "split": {"train": count - 2, "test": 2}})


def test_each_view_is_taken_where_and_when_the_plan_says() -> None:
    session = trajectory()
    timeline, planned = of_trajectory(session, MOUNT), plan(session, MOUNT)
    assert timeline.end == pytest.approx(duration(session, planned, MOUNT), abs=1e-9)
    assert (np.diff(timeline.seconds) >= 0).all()
    for stop, view in zip(timeline.stops, planned, strict=True):
        assert stop.seconds is not None
        assert np.allclose(timeline.at(stop.seconds), view.joints, atol=1e-12)
        assert np.allclose(stop.base_from_camera, view.viewpoint.camera_pose(MOUNT), atol=1e-5)  # by the closed form and back
        assert timeline.next_stop(stop.seconds) == stop
    assert timeline.next_stop(timeline.end + 1) is None


def test_no_joint_is_faster_than_the_trajectory_allows() -> None:
    session = trajectory()
    timeline = of_trajectory(session, MOUNT)
    span, moved = np.diff(timeline.seconds), np.abs(np.diff(timeline.joints, axis=0)).max(axis=1)
    assert (moved[span > 0] / span[span > 0] <= session.motion.speed + 1e-9).all()
    assert (moved[span == 0] < 1e-12).all()


def test_views_out_of_reach_stand_beside_the_plan_with_their_reason() -> None:
    timeline = of_trajectory(trajectory(0.65), MOUNT)
    blocked = [stop for stop in timeline.stops if stop.seconds is None]
    assert 0 < len(blocked) < 8 and len(timeline.stops) == 8
    assert all("out of reach" in stop.reason or "too near" in stop.reason or "singular" in stop.reason for stop in blocked)
    assert f"{len(blocked)} cannot be taken" in timeline.notes[0]


def test_where_nothing_can_be_taken_there_is_no_time() -> None:
    timeline = of_trajectory(trajectory(3.0), MOUNT)
    assert timeline.end == 0 and len(timeline.seconds) == 0 and all(stop.reason for stop in timeline.stops)


def recording_of(folder: Path, waits_s: list[float], angles: np.ndarray) -> Recording:
    """Views at these joint angles, with so much time between them."""
    recording = Recording.create(folder / "r", {"trajectory": trajectory(count=3).model_dump(mode="json")})
    for i, (joints, clock) in enumerate(zip(angles, 50.0 + np.cumsum([0.0, *waits_s]), strict=True)):
        name, pose = f"{i:03d}", kinematics.forward(joints)
        recording.append(
            Frame(
                index=i,
                name=name,
                split="train",
                image=f"images/{name}.png",
                base_from_flange=pose,
                joints=joints,
                robot_time_s=float(clock),
                host_time_ns=0,
                device_ticks=0,
                exposure_us=1e4,
                settle_s=0.3,
                sha256="",
            )
        )
    return recording


def test_a_recording_is_played_by_the_controllers_clock(tmp_path: Path) -> None:
    angles = np.deg2rad([[10.0 * i, -60, 80, -100, -90, 5] for i in range(2)])
    timeline = of_recording(recording_of(tmp_path, [1.5], angles), MOUNT)
    assert [stop.seconds for stop in timeline.stops] == [0, 1.5] and timeline.end == 1.5
    assert np.allclose(timeline.at(0.75), angles.mean(0))  # half way between the two
    assert np.allclose(timeline.stops[1].base_from_camera, kinematics.forward(angles[1]) @ MOUNT.flange_from_camera)
    assert timeline.notes[0].startswith("2 of 3 views in 2 s") and "waiting" not in " ".join(timeline.notes)


def test_long_waits_are_left_out_of_the_playback(tmp_path: Path) -> None:
    angles = np.deg2rad([[10.0 * i, -60, 80, -100, -90, 5] for i in range(3)])
    timeline = of_recording(recording_of(tmp_path, [7200.0, 1.5], angles), MOUNT)
    motion = trajectory(count=3).motion
    first = Pace.of(*angles[:2], motion, MOUNT).seconds + motion.settle_time_s + WAIT_S
    assert [stop.seconds for stop in timeline.stops] == pytest.approx([0, first, first + 1.5])
    assert timeline.notes[0] == f"3 of 3 views in {first + 1.5:.0f} s, without {7200 - first:.0f} s of waiting"


def test_a_recording_that_has_just_begun_shows_nothing_yet(tmp_path: Path) -> None:
    recording = Recording.create(tmp_path / "r", {"trajectory": trajectory().model_dump(mode="json")})
    assert of_recording(recording, MOUNT).stops == ()


def test_shipped_trajectories_can_be_played() -> None:
    timeline = of_trajectory(load_trajectory("koala_demo"), MOUNT)
    assert len(timeline.stops) == 50 and all(stop.seconds is not None for stop in timeline.stops)
