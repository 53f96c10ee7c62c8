import time
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from koala3d.capture.drivers.errors import MotionError
from koala3d.capture.drivers.protocols import Image, RobotState
from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import plan
from koala3d.capture.recording.check import check
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import files, locks
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording


class StandInRobot:
    """An arm that is at once wherever it is told to be."""

    def __init__(self) -> None:
        self.joints, self.moves, self.fail_after = load_arm("ur5e").home.copy(), 0, 10_000
        self.order: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        if self.moves >= self.fail_after:
            raise MotionError("did not arrive", remedy="resume the recording")
        self.joints, self.moves, self.order = np.array(joints), self.moves + 1, {"speed": speed, "acceleration": acceleration}

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        return RobotState(kinematics.forward(self.joints), self.joints.copy(), np.zeros(6), time.monotonic(), time.monotonic_ns())

    def stop(self) -> None: ...

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in"}


class StandInCamera:
    """Pictures that say how many were taken; stops the session like Ctrl-C before picture `stop_at`."""

    def __init__(self) -> None:
        self.taken, self.stop_at, self.kept = 0, float("inf"), []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def grab(self) -> Image:
        if self.taken == self.stop_at:
            raise KeyboardInterrupt
        self.taken += 1
        return Image(np.full((6, 8, 3), self.taken % 256, np.uint8), 2000.0, 0.0, self.taken, time.monotonic_ns())

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in", "region": {"width": 8, "height": 6, "offset_x": 0, "offset_y": 0, "binning": 1}}

    def prepare(self, frame: int) -> None: ...

    def save_truth(self, folder: Path, name: str, split: str) -> None:
        self.kept.append((name, split))


@pytest.fixture
def trajectory(demo) -> Trajectory:
    return demo


@pytest.fixture
def rig() -> Rig:
    camera = StandInCamera()
    return Rig(StandInRobot(), camera, RigDescription(), "sim", camera, {"scene": "gold_head", "seed": 0})


@pytest.fixture
def views(demo_views):
    return demo_views


def test_takes_every_view_where_it_was_planned(trajectory, rig, views, tmp_path):
    seen = []
    record(trajectory, rig, tmp_path / "rec", planned=views, advance=seen.append)
    recording = Recording.open(tmp_path / "rec")
    assert [frame.name for frame in recording.frames] == seen == [view.viewpoint.name for view in views]
    assert [frame.split for frame in recording.frames] == [view.viewpoint.split for view in views]
    for frame, view in zip(recording.frames, views, strict=True):
        assert np.array_equal(frame.joints, view.joints)
        np.testing.assert_allclose(frame.base_from_flange, kinematics.forward(view.joints), atol=1e-12)  # projected to rigid
        assert frame.sha256 == files.sha256(recording.image_path(frame))
        assert (images.to_uint8(images.read(recording.image_path(frame))) == frame.device_ticks).all()
        assert frame.settle_s >= trajectory.motion.settle_time_s
        assert np.array_equal(frame.joints_after, view.joints) and frame.robot_time_after_s > frame.robot_time_s
        np.testing.assert_allclose(frame.base_from_flange_after, frame.base_from_flange, atol=1e-12)
    assert rig.ground_truth.kept == [(frame.name, frame.split) for frame in recording.frames]


def test_manifest_says_what_the_next_steps_need(trajectory, rig, views, tmp_path):
    manifest = record(trajectory, rig, tmp_path / "rec", planned=views).manifest
    assert manifest["object"]["box"] == trajectory.object.corners.tolist() and manifest["board"] is None
    assert Trajectory.model_validate(manifest["trajectory"]) == trajectory
    assert np.array_equal(manifest["nominal_flange_from_camera"], rig.flange_from_camera)
    assert (manifest["scene"], manifest["seed"]) == ("gold_head", 0)
    assert manifest["camera"]["region"]["binning"] == 1 and manifest["robot"] == {"model": "stand-in"}


def test_board_is_described_for_a_calibration(rig, tmp_path):
    trajectory = load_trajectory("calibration_demo")
    views = plan(trajectory, rig.carrier)[:1]
    recording = record(trajectory, rig, tmp_path / "rec", planned=views)
    assert recording.manifest["board"] == {
        "type": "charuco",
        "squares_x": 9,
        "squares_y": 7,
        "square_length_m": 0.03,
        "marker_length_m": 0.022,
        "dictionary": "DICT_5X5_100",
        "legacy_pattern": False,
        "border_bits": 1,
        "first_id": 0,
    }
    assert recording.frames[0].split == "calibration"


def test_the_pose_after_is_read_after_the_exposure(trajectory, rig, views, tmp_path):
    def grab_while_it_sags():
        rig.robot.joints = rig.robot.joints + 1e-3
        return StandInCamera.grab(rig.camera)

    rig.camera.grab = grab_while_it_sags
    (frame,) = record(trajectory, rig, tmp_path / "rec", planned=views[:1]).frames
    np.testing.assert_allclose(frame.joints_after - frame.joints, 1e-3, atol=1e-12)
    (moved,) = [one for one in check(tmp_path / "rec") if one.what == "the arm moved during the exposure"]
    assert moved.frame == frame.name and moved.again


def test_a_stopped_session_is_resumed_without_a_duplicate(trajectory, rig, views, tmp_path):
    rig.camera.stop_at = 3
    with pytest.raises(KeyboardInterrupt):
        record(trajectory, rig, tmp_path / "rec", planned=views)
    before = Recording.open(tmp_path / "rec").frames
    assert len(before) == 3
    rig.camera.stop_at = float("inf")
    seen = []
    record(trajectory, rig, tmp_path / "rec", resume=True, planned=views, advance=seen.append)
    after = Recording.open(tmp_path / "rec").frames
    assert rig.camera.taken == 6 and len(seen) == 6
    assert [f.to_json() for f in after[:3]] == [f.to_json() for f in before]
    assert [f.name for f in after] == [v.viewpoint.name for v in views]


def test_image_without_a_line_is_taken_again(trajectory, rig, views, tmp_path):
    record(trajectory, rig, tmp_path / "rec", planned=views[:2])
    path = tmp_path / "rec" / "frames.jsonl"
    path.write_text(path.read_text()[:-40])  # killed while the second line was written
    record(trajectory, rig, tmp_path / "rec", resume=True, planned=views[:2])
    frames = Recording.open(tmp_path / "rec").frames
    assert [f.device_ticks for f in frames] == [1, 3]
    assert (images.to_uint8(images.read(tmp_path / "rec" / frames[1].image)) == 3).all()


def test_finished_session_resumes_to_nothing(trajectory, rig, views, tmp_path):
    record(trajectory, rig, tmp_path / "rec", planned=views[:2])
    moves = rig.robot.moves
    record(trajectory, rig, tmp_path / "rec", resume=True, planned=views[:2])
    assert (rig.robot.moves, rig.camera.taken) == (moves, 2)


def test_failed_motion_leaves_a_recording_that_resumes(trajectory, rig, views, tmp_path):
    rig.robot.fail_after = 4
    with pytest.raises(MotionError):
        record(trajectory, rig, tmp_path / "rec", planned=views)
    count = len(Recording.open(tmp_path / "rec").frames)
    rig.robot.fail_after = 10_000
    record(trajectory, rig, tmp_path / "rec", resume=True, planned=views)
    assert 0 < count < 6 and len(Recording.open(tmp_path / "rec").frames) == rig.camera.taken == 6


def test_nothing_is_overwritten(trajectory, rig, views, tmp_path):
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="already exists"):
        record(trajectory, rig, tmp_path / "rec", planned=views)
    assert rig.robot.moves == 0 and (tmp_path / "rec" / "thesis.txt").read_text() == "mine"


def test_another_session_cannot_resume_here(trajectory, rig, views, tmp_path):
    record(trajectory, rig, tmp_path / "rec", planned=views[:1])
    for change in ({"speed": 2.0}, {"speed": 0.5, "acceleration": 9.0}, {"speed": 0.5, "settle_time_s": 7.0}):
        other = trajectory.model_copy(update={"motion": trajectory.motion.model_copy(update=change)})
        with pytest.raises(UsageError, match="another trajectory"):
            record(other, rig, tmp_path / "rec", resume=True, planned=views)
    other = Rig(rig.robot, rig.camera, rig.description, rig.name, rig.ground_truth, {"scene": "gold_head", "seed": 1})
    with pytest.raises(UsageError, match="another seed"):
        record(trajectory, other, tmp_path / "rec", resume=True, planned=views)
    turned = Rig(rig.robot, rig.camera, rig.description, rig.name, rig.ground_truth, {**rig.extra, "pose": "under"})
    with pytest.raises(UsageError, match=r"another pose"):
        record(trajectory, turned, tmp_path / "rec", resume=True, planned=views)


def test_a_recording_is_resumed_more_slowly(trajectory, rig, views, tmp_path):
    before = record(trajectory, rig, tmp_path / "rec", planned=views[:1]).manifest
    slow = {"speed": 0.1, "acceleration": 0.3}
    slower = trajectory.model_copy(update={"motion": trajectory.motion.model_copy(update=slow)})
    found = record(slower, rig, tmp_path / "rec", resume=True, planned=views[:2])
    assert len(found.frames) == 2 and found.manifest == before and rig.robot.order == slow
    assert len(record(trajectory, rig, tmp_path / "rec", resume=True, planned=views).frames) == len(views)


def test_incomplete_files_of_a_kill_are_removed(trajectory, rig, views, tmp_path):
    out = tmp_path / "rec"
    (out / "images").mkdir(parents=True)
    (out / ".manifest.x1y2.json").write_text("{")  # killed before the manifest was there
    record(trajectory, rig, out, resume=True, planned=views[:1])
    (out / "images" / ".001.x1y2.png").write_bytes(b"half")
    record(trajectory, rig, out, resume=True, planned=views[:2])
    assert len(Recording.open(out).frames) == 2 and not [path for path in out.rglob(".*")]


def test_a_folder_that_is_no_recording_is_not_touched(trajectory, rig, views, tmp_path):
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec" / ".secret.txt").write_text("mine")
    (tmp_path / "rec" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="is not a recording"):
        record(trajectory, rig, tmp_path / "rec", resume=True, planned=views)
    assert (tmp_path / "rec" / ".secret.txt").exists()


def test_another_address_or_client_is_the_same_rig(trajectory, rig, views, tmp_path):
    record(trajectory, rig, tmp_path / "rec", planned=views[:1])
    elsewhere = rig.description.robot.model_copy(update={"host": "10.0.0.7", "client": "koala"})
    moved = rig.description.model_copy(update={"robot": elsewhere})
    there = Rig(rig.robot, rig.camera, moved, "copy.yaml", rig.ground_truth, rig.extra)
    assert len(record(trajectory, there, tmp_path / "rec", resume=True, planned=views[:2]).frames) == 2
    slower = moved.model_copy(update={"robot": moved.robot.model_copy(update={"max_joint_speed": 0.9})})
    with pytest.raises(UsageError, match="another rig"):
        record(
            trajectory,
            Rig(rig.robot, rig.camera, slower, "", rig.ground_truth, rig.extra),
            tmp_path / "rec",
            resume=True,
            planned=views,
        )


def test_it_waits_for_two_equal_pictures_if_requested(trajectory, rig, views, tmp_path):
    """The stand-in's pictures get brighter by one level each: two never differ by less than 1/255."""
    waiting = trajectory.motion.model_copy(update={"settle_difference": 0.01, "settle_timeout_s": 0.2})
    record(trajectory.model_copy(update={"motion": waiting}), rig, tmp_path / "rec", planned=views[:2])
    assert rig.camera.taken == 4  # each view's second picture is equal enough to its first
    never = trajectory.model_copy(update={"motion": waiting.model_copy(update={"settle_difference": 0.001})})
    with pytest.raises(MotionError, match=r"view 000: the picture does not come to rest .*0\.0039, limit 0\.001"):
        record(never, rig, tmp_path / "other", planned=views[:2])


def test_resume_without_a_recording_starts_one(trajectory, rig, views, tmp_path):
    assert len(record(trajectory, rig, tmp_path / "new", resume=True, planned=views[:1]).frames) == 1


@pytest.mark.parametrize("resume", [False, True])
def test_one_session_at_a_time_writes_to_a_recording(trajectory, rig, views, tmp_path, resume):
    with locks.beside(tmp_path / "rec", "recording"), pytest.raises(UsageError, match=r"recording is in use \(by .*process"):
        record(trajectory, rig, tmp_path / "rec", planned=views, resume=resume)
    assert list(tmp_path.iterdir()) == []
    assert len(record(trajectory, rig, tmp_path / "rec", planned=views).frames) == len(views)
