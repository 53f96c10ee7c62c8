"""A recording on its page while it is being made."""

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.rig import RigDescription, recorded_rig
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.page.live import TALL, LiveView, with_histogram
from koala3d.capture.page.session import CaptureView
from koala3d.capture.page.timeline import of_planned
from koala3d.capture.page.view import show, watch
from koala3d.capture.planning import PlannedView, plan
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.datasets.page import open_page
from koala3d.datasets.recording import Frame, Recording
from tests.browser import PATIENCE_S, Browse

MOUNT = RigDescription().carrier()


@pytest.fixture(scope="module")
def session() -> tuple[Trajectory, list[PlannedView]]:
    view = {"kind": "orbit", "target": [0.4, 0.0, 0.14], "distance": 0.4, "elevation_deg": 40, "count": 4}
    views = [view | {"roll_deg": [0, 90, 180, 270]}]
    trajectory = Trajectory.model_validate({"name": "ring", "views": views, "split": {"train": 3, "test": 1}})
    return trajectory, plan(trajectory, MOUNT)


UR5E = load_arm("ur5e").model_dump(mode="json")


def begin(path: Path, trajectory: Trajectory) -> Recording:
    rig = {"name": "sim", "flange_from_camera": RigDescription().flange_from_camera.model_dump(mode="json")}
    return Recording.create(path, {"trajectory": trajectory.model_dump(mode="json"), "rig": rig, "arm": UR5E})


def take(recording: Recording, planned: list[PlannedView], index: int, grey: int) -> None:
    view, joints, image = planned[index].viewpoint, planned[index].joints, f"images/{index:03d}.png"
    images.write(recording.path / image, np.full((24, 32, 3), grey, np.uint8))
    recording.append(
        Frame(
            index=index,
            name=view.name,
            split=view.split,
            image=image,
            base_from_flange=np.eye(4),
            joints=joints,
            robot_time_s=10.0 + index,
            host_time_ns=0,
            device_ticks=0,
            exposure_us=1e4,
            settle_s=0.3,
            sha256="",
        )
    )


def test_frames_appear_as_they_come_and_the_arm_goes_along(tmp_path: Path, session: Any) -> None:
    trajectory, planned = session
    with open_page("live", 0) as page:
        shown = CaptureView(page, trajectory, MOUNT, of_planned(trajectory, planned, MOUNT))
        live = LiveView(shown, tmp_path / "r", MOUNT)
        live.update()  # there is no recording yet
        recording = begin(tmp_path / "r", trajectory)
        live.update()
        assert live.seen == set()
        take(recording, planned, 0, 100)
        take(recording, planned, 1, 255)
        live.update()
        assert live.seen == {"000", "001"} and shown.slider.value == pytest.approx(shown.stops["001"].seconds)
        assert "2 of 4 taken" in live._words.content and "100.0 % of the pixels are clipped" in live._words.content
        assert shown.frusta["001"].image is not None
        assert "exposed for 10 ms" in shown.stops["000"].measured


def test_an_unreadable_picture_is_reported(tmp_path: Path, session: Any) -> None:
    trajectory, planned = session
    recording = begin(tmp_path / "r", trajectory)
    take(recording, planned, 0, 100)
    (tmp_path / "r" / "images" / "000.png").write_bytes(b"\x89PNG and no more")
    with open_page("live", 0) as page:
        live = LiveView(CaptureView(page, trajectory, MOUNT, of_planned(trajectory, planned, MOUNT)), tmp_path / "r", MOUNT)
        live.update()
        assert "cannot be read" in live._words.content


def test_a_recording_that_is_not_complete_is_shown_by_its_plan(tmp_path: Path, session: Any) -> None:
    trajectory, planned = session
    recording = begin(tmp_path / "r", trajectory)
    take(recording, planned, 0, 100)
    with open_page("live", 0) as page:
        assert show(page, tmp_path / "r", RigDescription())["views"] == 4
    for index in (1, 2, 3):
        take(recording, planned, index, 100)
    with open_page("done", 0) as page:
        assert show(page, tmp_path / "r", RigDescription()) == {"name": "ring", "views": 4, "blocked": 0, "seconds": 3.0}


def test_a_path_that_is_neither_trajectory_nor_recording_is_an_error(tmp_path: Path) -> None:
    with open_page("nothing", 0) as page:
        with pytest.raises(UsageError, match="not a recording"):
            show(page, tmp_path, RigDescription())
        with pytest.raises(UsageError):
            show(page, tmp_path / "missing.yaml", RigDescription())


def test_a_recording_brings_its_own_mount(tmp_path: Path, session: Any) -> None:
    recording = begin(tmp_path / "r", session[0])
    recording.manifest["rig"]["flange_from_camera"] = {"position": [0, 0, 0.2], "rotation_deg": [0, 0, 0]}
    description = recorded_rig(recording)
    assert np.allclose(description.flange_from_camera.matrix()[:3, 3], [0, 0, 0.2])


def test_the_histogram_counts_what_the_picture_has() -> None:
    picture = np.zeros((10, 256, 3), np.uint8)
    picture[..., 0] = 64
    picture[:, :128, 1] = 255
    drawn, clipped = with_histogram(picture)
    assert drawn.shape == (10 + TALL, 256, 3) and np.array_equal(drawn[:10], picture) and clipped == 0.5
    foot = drawn[-1]
    assert (foot[64] == [255, 127, 127]).all() and (foot[255] == [127, 255, 127]).all()  # red at 64, green at the right end
    assert (foot[150] == 255).all()


@pytest.mark.timeout(600)
def test_a_browser_sees_frames_arrive_and_stops_the_arm(tmp_path: Path, session: Any, browse: Browse) -> None:
    trajectory, planned = session
    stopped = threading.Event()
    with open_page("stop", 0) as page:
        watch(page, tmp_path / "r", trajectory, MOUNT, planned, stop=stopped.set)
        with browse(page) as window:
            window.page.get_by_text("none yet").wait_for()
            take(begin(tmp_path / "r", trajectory), planned, 0, 100)
            window.page.get_by_text("1 of 4 taken").wait_for()
            window.page.get_by_text("stop the arm").click()
            assert stopped.wait(PATIENCE_S)
