"""Several cameras on one flange: every view is taken by all of them at one stop, each into a recording of its own."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.protocols import Image, RobotState
from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription, recorded_rig
from koala3d.capture.model.trajectory import Trajectory, load_trajectory
from koala3d.capture.planning import PlannedView, plan
from koala3d.capture.recording.growing import GrowingRecording
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.naming import describe
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core.errors import KoalaError, UsageError
from koala3d.datasets.recording import FRAMES, MANIFEST, Recording

PAIR = describe("ur5e_stereo")


class Arm:
    """An arm that is at once wherever it is told to be, and whose reported angles creep from reading to reading."""

    def __init__(self) -> None:
        self.joints, self.readings = load_arm("ur5e").home.copy(), 0

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        self.joints = np.array(joints)

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        self.readings += 1
        joints = self.joints + 1e-9 * self.readings
        return RobotState(kinematics.forward(joints), joints, np.zeros(6), time.monotonic(), time.monotonic_ns())

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in"}


class Eye:
    """Pictures that say how many were taken; fails at picture `fail_at`."""

    def __init__(self, serial: str) -> None:
        self.serial, self.taken, self.fail_at = serial, 0, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def grab(self) -> Image:
        self.taken += 1
        if self.taken == self.fail_at:
            raise CaptureError("camera gave no image", where=f"camera {self.serial}", remedy="check its cable")
        return Image(np.full((6, 8, 3), self.taken % 256, np.uint8), 2000.0, 0.0, self.taken, time.monotonic_ns())

    def set_exposure(self, exposure_us: float) -> None: ...

    def description(self) -> dict[str, Any]:
        region = {"width": 8, "height": 6, "offset_x": 0, "offset_y": 0, "binning": 1}
        return {"model": "stand-in", "serial": self.serial, "region": region}


@pytest.fixture
def rig() -> Rig:
    arm = Arm()
    rigs = {name: Rig(arm, Eye(f"{name} eye"), one, "lab") for name, one in PAIR.each.items()}
    return replace(rigs["left"], cameras=rigs)


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return load_trajectory(
        "koala_demo", overrides=["views.0.azimuth_deg=[-170, 170]"]
    )  # between arm and object is no room for two


@pytest.fixture(scope="module")
def views(trajectory: Trajectory) -> list[PlannedView]:
    return plan(trajectory, PAIR.carrier())[:4]


def both(out: Path) -> list[Recording]:
    return [Recording.open(out / name) for name in ("left", "right")]


def test_all_cameras_take_a_view_at_one_stop(trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path) -> None:
    seen: list[str] = []
    record(trajectory, rig, tmp_path / "rec", planned=views, advance=seen.append)
    left, right = both(tmp_path / "rec")
    assert [frame.name for frame in left.frames] == [frame.name for frame in right.frames] == seen
    for one, other in zip(left.frames, right.frames, strict=True):
        assert one.robot_time_s == other.robot_time_s < other.robot_time_after_s == one.robot_time_after_s
        assert np.array_equal(one.joints, other.joints) and np.array_equal(one.joints_after, other.joints_after)
        assert not np.array_equal(one.joints, one.joints_after)  # the premise: two readings differ
        assert one.host_time_ns < other.host_time_ns
    for name, recording in zip(("left", "right"), (left, right), strict=True):
        assert recording.part("camera")["serial"] == f"{name} eye"
        mount = PAIR.cameras[name].flange_from_camera.matrix()
        assert np.array_equal(recording.manifest["nominal_flange_from_camera"], mount)
        assert recorded_rig(recording) == PAIR.each[name] and recorded_rig(recording).name == name


def test_a_stop_that_one_camera_lacks_is_taken_again_by_all(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    record(trajectory, rig, out, planned=views[:3])
    lines = (out / "right" / FRAMES).read_text()
    (out / "right" / FRAMES).write_text(lines[:-40])  # killed while the line of the last view was written
    record(trajectory, rig, out, planned=views, resume=True)
    for recording in both(out):
        assert [frame.name for frame in recording.frames] == [view.viewpoint.name for view in views]
        assert [frame.device_ticks for frame in recording.frames] == [1, 2, 4, 5]  # the third is the fourth picture
        assert len(list((recording.path / "images").iterdir())) == 4
    assert both(out)[0].frames[2].robot_time_s == both(out)[1].frames[2].robot_time_s


def test_a_half_taken_stop_is_kept_until_it_is_taken_again(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    record(trajectory, rig, out, planned=views[:2])
    both(out)[1].discard(["001"])
    rig.cameras["right"].camera.fail_at = 3
    with pytest.raises(CaptureError):
        record(trajectory, rig, out, planned=views[:2], resume=True)
    assert [len(recording.frames) for recording in both(out)] == [2, 1]


def test_a_camera_that_fails_is_named_and_the_session_goes_on_there(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    rig.cameras["right"].camera.fail_at = 2
    with pytest.raises(CaptureError, match=r"^camera 'right', camera right eye: camera gave no image; check its cable$"):
        record(trajectory, rig, tmp_path / "rec", planned=views)
    assert [len(recording.frames) for recording in both(tmp_path / "rec")] == [1, 1]
    record(trajectory, rig, tmp_path / "rec", planned=views, resume=True)
    assert [len(recording.frames) for recording in both(tmp_path / "rec")] == [4, 4]


def test_a_kill_before_the_second_recording_was_begun(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    record(trajectory, rig, tmp_path / "rec", planned=[])
    (tmp_path / "rec" / "right" / MANIFEST).unlink()
    record(trajectory, rig, tmp_path / "rec", planned=views[:1], resume=True)
    assert [len(recording.frames) for recording in both(tmp_path / "rec")] == [1, 1]


def test_a_recording_of_one_camera_is_not_continued_by_two(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    alone = replace(rig, cameras={}, description=RigDescription())
    record(trajectory, alone, tmp_path / "rec", planned=views[:1])
    with pytest.raises(UsageError, match=r"rec: is the recording of one camera \(the rig has 2\)"):
        record(trajectory, rig, tmp_path / "rec", planned=views, resume=True)
    with pytest.raises(UsageError, match="already exists"):
        record(trajectory, rig, tmp_path / "rec", planned=views)


def test_another_second_camera_is_another_camera(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path
) -> None:
    record(trajectory, rig, tmp_path / "rec", planned=views[:1])
    other = replace(rig.cameras["right"], camera=Eye("new eye"))
    with pytest.raises(UsageError, match=r"another camera \(serial right eye, now new eye\)"):
        record(trajectory, replace(rig, cameras={**rig.cameras, "right": other}), tmp_path / "rec", planned=views, resume=True)


def test_the_disk_must_have_room_for_all_cameras(
    trajectory: Trajectory, rig: Rig, views: list[PlannedView], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr("koala3d.capture.recording.recorder.require_room", lambda out, size, what: asked.append(size))
    record(trajectory, rig, tmp_path / "two", planned=views[:1])
    record(trajectory, replace(rig, cameras={}), tmp_path / "one", planned=views[:1])
    assert asked[0] == 2 * asked[1] > 0


def test_sessions_that_choose_their_views_are_for_one_camera(trajectory: Trajectory, rig: Rig, tmp_path: Path) -> None:
    with pytest.raises(KoalaError, match=r"^capture run --adaptive: chooses its views for one camera \(the rig has 2\); use"):
        GrowingRecording(trajectory, rig, tmp_path / "rec", "capture run --adaptive")
