"""The pages as a browser shows them: what must be seen is seen, nothing comes from elsewhere, and they end when asked to."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datasets import pose
from datasets.calibration import Calibration, UncertainPose
from datasets.camera_model import Camera
from datasets.formats import koala
from datasets.page import open_page, shapes
from datasets.scene import Scene

pytestmark = pytest.mark.timeout(600)


def near(picture: np.ndarray, colour: tuple[int, int, int], tolerance: int = 40) -> int:
    """Number of pixels of about a colour: lines are blended with what is behind them."""
    return int((np.abs(picture.astype(int) - colour).max(-1) < tolerance).sum())


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def test_a_scene_shows_its_cameras_and_ends_on_ctrl_c(saved: Path, browse: Callable[[str], Any]) -> None:
    """The whole command, and two browsers at once: cameras in the colours of their splits; the picture of a view in the panel of the
    browser that asked for it and of no other."""
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from datasets.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "view", str(saved), "--port", "0", "--quick", "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        said = json.loads(process.stdout.readline())
        assert said["url"].startswith("http://127.0.0.1:") and said["views"] == {"train": 6, "val": 0, "test": 3}
        window, other = browse(said["url"]), browse(said["url"])
        seen = lambda picture: near(picture, shapes.COLOURS["train"]) > 30 and near(picture, shapes.COLOURS["test"]) > 15  # noqa: E731
        first = window.until(seen, "cameras in two colours")
        other.until(seen, "cameras in two colours")
        window.page.get_by_text("look through it").click()
        window.page.get_by_text("000.png").wait_for(timeout=1e3 * window.PATIENCE_S)
        window.until(
            lambda picture: (np.abs(picture.astype(int) - first) > 40).mean() > 0.05, "another view after 'look through it'"
        )
        assert other.page.get_by_text("000.png").count() == 0
        assert window.errors == other.errors == [] and window.outside() == other.outside() == []
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
        took = time.monotonic() - start
        assert took < 5, f"{took:.1f} s"  # 0.1 to 0.4 s where the computer has time; the promise is one second
    finally:
        process.kill()


def test_findings_are_where_they_belong(saved: Path, browse: Callable[[str], Any]) -> None:
    from datasets.page import view

    (saved / "images" / "003.png").write_bytes((saved / "images" / "002.png").read_bytes())
    scene = koala.load(saved)
    with open_page("findings", 0) as page:
        shown = view.SceneView(page, scene)
        findings = shown.add_findings(saved, matches=False)
        about = next(finding for finding in findings if "same" in finding.what)
        assert [concerned.name for concerned in view.views_of(about, scene)] == ["003"]
        mark = page.scene.get_handle_by_name(f"/findings/{findings.index(about)}/003/ball")
        assert np.allclose(mark.position, scene.views[3].world_from_camera[:3, 3])
        window = browse(page.url)
        window.until(lambda picture: near(picture, shapes.COLOURS["warning"]) > 20, "the mark of a warning")
        window.page.get_by_text("image is the same as another's").first.wait_for(timeout=1e3 * window.PATIENCE_S)
        assert window.errors == []


TRAJECTORY = """
format: koala-trajectory
version: 1
name: nearly
views: [{kind: orbit, target: [0.55, 0.0, 0.14], distance: 0.4, elevation_deg: 30, count: 8, roll_deg: [0, 90, 180, 270]}]
split: {train: 6, test: 2}
object: {centre: [0.55, 0.0, 0.15], size: [0.2, 0.2, 0.3]}
safety: {workspace: {centre: [0.45, 0, 0.4], size: [1.0, 1.2, 0.8]}}
"""


def test_a_trajectory_shows_the_arm_moving_and_what_it_cannot_take(tmp_path: Path, browse: Callable[[str], Any]) -> None:
    from capture.page.session import SAFETY, CaptureView
    from capture.page.timeline import of_trajectory
    from capture.planning.obstacles import PARTS, segments
    from capture.rig.description import RigDescription
    from capture.trajectory import load_trajectory

    (tmp_path / "t.yaml").write_text(TRAJECTORY)
    trajectory, mount = load_trajectory(tmp_path / "t.yaml"), RigDescription().flange_from_camera.matrix()
    timeline = of_trajectory(trajectory, mount)
    blocked = [stop for stop in timeline.stops if stop.reason]
    assert blocked and len(blocked) < 8
    with open_page("arm", 0) as page:
        shown = CaptureView(page, trajectory, mount, timeline)
        window = browse(page.url)
        before = window.until(lambda p: near(p, SAFETY, 60) > 30 and near(p, shapes.COLOURS["blocked"]) > 10, "volumes and views")
        window.page.get_by_text(blocked[0].reason).first.wait_for(timeout=1e3 * window.PATIENCE_S)
        shown.slider.value = timeline.end
        window.until(lambda picture: (np.abs(picture.astype(int) - before) > 40).mean() > 0.005, "the arm elsewhere")
        expected = segments(timeline.at(timeline.end), mount)[PARTS.index("camera"), 0]
        assert np.allclose(page.scene.get_handle_by_name("/arm/camera").position, expected, atol=1e-5)
        assert window.errors == []


def test_a_calibration_shows_its_target_and_what_is_missing(browse: Callable[[str], Any]) -> None:
    """Without its recording, the page has the target, the certainty, and a sentence that says why there is no more."""
    from calib.page.view import show

    known = UncertainPose(pose.from_rotation_vector([np.pi, 0, 0], [0.3, 0.1, 0.0]), np.diag([1e-9] * 3 + [1e-8] * 3))
    board = {"type": "charuco", "squares_x": 9, "squares_y": 7, "square_length_m": 0.03, "marker_length_m": 0.022,
             "dictionary": "DICT_5X5_100"}  # fmt: skip
    residuals = {"rms_px": 0.03, "corners": 100, "views_used": 9, "coverage": 0.7}
    calibration = Calibration(Camera(960, 540, 640.0, 640.0, 480.0, 270.0), {"fx": 0.1}, known, known, residuals=residuals,
                              provenance={"board": board, "recording": "/nowhere"})  # fmt: skip
    with open_page("calibration", 0) as page:
        show(page, calibration)
        window = browse(page.url)
        window.until(lambda p: near(p, (30, 30, 30)) > 200 and near(p, (235, 235, 235), 15) > 200, "dark and light squares")
        window.page.get_by_text("the recording is not there").wait_for(timeout=1e3 * window.PATIENCE_S)
        assert window.page.locator("img").count() >= 1
        window.page.get_by_text("translation: 300.000 ±").first.wait_for(timeout=1e3 * window.PATIENCE_S)
        assert window.errors == [] and window.outside() == []


@pytest.mark.parametrize(("metric", "place"), [(True, "at 1, 2, 0.5 m"), (False, "at 1, 2, 0.5")])
def test_a_view_is_told_with_its_place_in_its_unit(make_scene: Callable[..., Scene], metric: bool, place: str) -> None:
    from dataclasses import replace

    from datasets.page.view import status_text

    view = replace(make_scene().views[0], world_from_camera=pose.rigid(np.eye(3), np.array([1.0, 2.0, 0.5])), truth={})
    assert status_text(view, metric=metric).endswith(place)
