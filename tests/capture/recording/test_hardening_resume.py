"""A recording is resumed with the rig that it was begun with, and says which that was."""

import time
from datetime import datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from koala3d.capture.drivers.protocols import Image, RobotState
from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import CameraDescription, RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import PlannedView
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import FRAMES, MANIFEST, Recording

ROBOT = {"model": "UR5e", "serial": "20235500001"}
CAMERA = {"model": "acA1920-25uc", "serial": "21000001"}


class Still:
    """A robot and a camera in one that does nothing but answer."""

    def __init__(self, description: dict[str, Any]) -> None:
        self._description, self.joints, self.taken = description, load_arm("ur5e").home.copy(), 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        self.joints = np.array(joints)

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        return RobotState(kinematics.forward(self.joints), self.joints.copy(), np.zeros(6), time.monotonic(), time.monotonic_ns())

    def stop(self) -> None: ...

    def grab(self) -> Image:
        self.taken += 1
        return Image(np.full((6, 8, 3), self.taken, np.uint8), 2000.0, 0.0, self.taken, time.monotonic_ns())

    def description(self) -> dict[str, Any]:
        return self._description


def rig(robot: dict[str, Any], camera: dict[str, Any], lens: str = "2.8 mm, f/8") -> Rig:
    description = RigDescription(camera=CameraDescription(lens=lens))
    return Rig(Still(robot), Still(camera), description, "lab", None, {})


@pytest.fixture
def trajectory(demo: Trajectory) -> Trajectory:
    return demo


@pytest.fixture
def views(demo_views: list[PlannedView]) -> list[PlannedView]:
    return demo_views[:3]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"robot": {**ROBOT, "serial": "20235500002"}}, r"another arm \(serial 20235500001, now 20235500002\)"),
        ({"robot": {**ROBOT, "model": "UR10e"}}, r"another arm \(model UR5e, now UR10e\)"),
        ({"robot": {"model": "UR5e"}}, r"another arm \(serial 20235500001, now not known\)"),
        ({"camera": {**CAMERA, "serial": "21000002"}}, r"another camera \(serial 21000001, now 21000002\)"),
        ({"lens": "4 mm, f/8"}, r"another lens \(lens 2.8 mm, f/8, now 4 mm, f/8\); use the original lens"),
    ],
    ids=["arm", "model", "nameless", "camera", "lens"],
)
def test_resume_with_another_rig_is_refused_by_name(
    trajectory: Trajectory, views: list[PlannedView], tmp_path: Path, changes: dict[str, Any], named: str
) -> None:
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views[:2])
    with pytest.raises(UsageError, match=named):
        other = rig(**{"robot": ROBOT, "camera": CAMERA, **changes})
        record(trajectory, other, tmp_path / "rec", planned=views, resume=True)


def test_a_recording_that_does_not_name_its_devices_is_resumed(
    trajectory: Trajectory, views: list[PlannedView], tmp_path: Path
) -> None:
    """Older ones have neither a date nor a lens; the rig file may have gained one since."""
    record(trajectory, rig(ROBOT, CAMERA, lens=""), tmp_path / "rec", planned=views[:2])
    path = tmp_path / "rec" / MANIFEST
    content = files.read_json(path)
    del content["started"], content["camera"]["lens"], content["rig"]["camera"]["lens"]
    del content["robot"]["serial"], content["camera"]["serial"]
    files.write_json(path, content)
    before = path.read_bytes()
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views, resume=True)
    assert len(Recording.open(tmp_path / "rec").frames) == 3 and path.read_bytes() == before


def test_resume_with_the_same_rig_at_another_address_goes_on(
    trajectory: Trajectory, views: list[PlannedView], tmp_path: Path
) -> None:
    record(trajectory, rig({**ROBOT, "host": "10.0.0.1"}, CAMERA), tmp_path / "rec", planned=views[:2])
    record(trajectory, rig({**ROBOT, "host": "10.0.0.2"}, CAMERA), tmp_path / "rec", planned=views, resume=True)
    assert len(Recording.open(tmp_path / "rec").frames) == 3


def test_a_recording_says_when_it_was_begun(trajectory: Trajectory, views: list[PlannedView], tmp_path: Path) -> None:
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views[:1])
    moment = datetime.fromisoformat(Recording.open(tmp_path / "rec").manifest["started"])
    assert moment.tzinfo is not None and abs((datetime.now().astimezone() - moment).total_seconds()) < 60


@pytest.mark.parametrize("damage", ["cut", "zeros"])
def test_the_last_line_after_a_power_cut(trajectory: Trajectory, views: list[PlannedView], tmp_path: Path, damage: str) -> None:
    """A file that grew before its data was on the disk ends in half a line, or in zeros without an end of line."""
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views[:2])
    with open(tmp_path / "rec" / FRAMES, "ab") as file:
        file.write(b'{"index": 2, "na' if damage == "cut" else bytes(700))
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views, resume=True)
    assert len(Recording.open(tmp_path / "rec").frames) == 3


def test_a_view_whose_image_is_missing_is_taken_again(trajectory: Trajectory, views: list[PlannedView], tmp_path: Path) -> None:
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views)
    (tmp_path / "rec" / "images" / "001.png").unlink()
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views, resume=True)
    recording = Recording.open(tmp_path / "rec")
    assert sorted(frame.name for frame in recording.frames) == ["000", "001", "002"]
    assert all(files.sha256(recording.image_path(frame)) == frame.sha256 for frame in recording.frames)


def test_a_recording_whose_images_are_elsewhere_keeps_its_frames(
    trajectory: Trajectory, views: list[PlannedView], tmp_path: Path
) -> None:
    """They may be on a disk that is not mounted."""
    record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views)
    (tmp_path / "rec" / "images").rename(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=r"rec: all its images are missing \(3 views\)"):
        record(trajectory, rig(ROBOT, CAMERA), tmp_path / "rec", planned=views, resume=True)
    assert len(Recording.open(tmp_path / "rec").frames) == 3
