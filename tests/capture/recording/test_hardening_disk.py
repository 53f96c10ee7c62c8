"""A disk that is full: it is said before the arm moves where that can be known, and costs nothing that was complete."""

import shutil
import time
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.drivers.protocols import Image, RobotState
from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import PlannedView
from koala3d.capture.recording import recorder
from koala3d.capture.recording.recorder import record
from koala3d.capture.rig.rig import Rig
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.recording import Recording


class Noisy:
    """A robot and a camera in one, whose pictures cannot be compressed."""

    def __init__(self) -> None:
        self.joints, self.moves, self.random = load_arm("ur5e").home.copy(), 0, np.random.default_rng(0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: np.ndarray, *, speed: float, acceleration: float) -> None:
        self.joints, self.moves = np.array(joints), self.moves + 1

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        return RobotState(kinematics.forward(self.joints), self.joints.copy(), np.zeros(6), time.monotonic(), time.monotonic_ns())

    def stop(self) -> None: ...

    def grab(self) -> Image:
        return Image(self.random.integers(0, 255, (216, 216, 3)).astype(np.uint8), 2000.0, 0.0, 0, time.monotonic_ns())

    def description(self) -> dict[str, Any]:
        return {"model": "stand-in"}


@pytest.fixture
def rig() -> Rig:
    both = Noisy()
    return Rig(both, both, RigDescription(), "lab", None, {})


@pytest.fixture
def trajectory(demo: Trajectory) -> Trajectory:
    return demo


@pytest.fixture
def views(demo_views: list[PlannedView]) -> list[PlannedView]:
    return demo_views


@pytest.mark.parametrize("left", [1_500_000, 700_000, 300_000, 145_000, 20_000])
def test_a_disk_that_fills_up_costs_no_frame(
    trajectory: Trajectory, views: list[PlannedView], rig: Rig, small_disk: Path, left: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program fills it after the room was asked for."""
    monkeypatch.setattr(recorder, "require_room", lambda folder, size, what: None)
    (small_disk / "filling").write_bytes(bytes(shutil.disk_usage(small_disk).free - left))
    try:
        record(trajectory, rig, small_disk / "rec", planned=views)
    except CaptureError as error:
        assert "rec: the disk is full" in str(error) and "--resume" in str(error) and "\n" not in str(error)
    else:
        assert left > 1_000_000  # six pictures of 140 kB
    held = Recording.open(small_disk / "rec").frames if (small_disk / "rec" / "manifest.json").exists() else []
    for frame in held:
        assert files.sha256(small_disk / "rec" / frame.image) == frame.sha256
    (small_disk / "filling").unlink()
    record(trajectory, rig, small_disk / "rec", planned=views, resume=True)
    recording = Recording.open(small_disk / "rec")
    assert [frame.name for frame in recording.frames][: len(held)] == [frame.name for frame in held]
    assert len({frame.name for frame in recording.frames}) == len(recording.frames) == 6
    assert not list((small_disk / "rec").rglob(".*"))


def test_a_recording_without_room_is_refused_before_the_arm_moves(
    trajectory: Trajectory, views: list[PlannedView], rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: type(usage)(usage.total, usage.total - 100_000, 100_000))
    with pytest.raises(KoalaError, match=r"rec: the disk has no room for the pictures \(up to .* kB needed, 100.0 kB free\)"):
        record(trajectory, rig, tmp_path / "rec", planned=views)
    assert rig.robot.moves == 0 and not (tmp_path / "rec").exists()  # type: ignore[attr-defined]


def test_resume_asks_for_room_for_the_missing_views_alone(
    trajectory: Trajectory, views: list[PlannedView], rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(trajectory, rig, tmp_path / "rec", planned=views[:5])
    asked: list[tuple[float, str]] = []
    monkeypatch.setattr(recorder, "require_room", lambda folder, size, what: asked.append((size, what)))
    record(trajectory, rig, tmp_path / "rec", planned=views, resume=True)
    ((size, what),) = asked
    assert what == "the pictures" and 216 * 216 * 3 < size < 1.2 * 216 * 216 * 3
    assert size > (tmp_path / "rec" / "images" / "005.png").stat().st_size  # which cannot be compressed
