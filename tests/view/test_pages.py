"""The pages in a browser, one test per package: content is visible, nothing is loaded from other hosts, Ctrl-C ends them."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser

from datasets import pose
from datasets.calibration import Calibration, UncertainPose
from datasets.camera_model import Camera
from datasets.formats import koala
from datasets.page import open_page, shapes
from datasets.scene import Scene

pytestmark = pytest.mark.timeout(600)


def near(picture: np.ndarray, colour: tuple[int, int, int], tolerance: int = 40) -> int:
    """Number of pixels close to a colour; lines are blended with the background."""
    return int((np.abs(picture.astype(int) - colour).max(-1) < tolerance).sum())


@pytest.fixture
def saved(make_scene: Callable[..., Scene], tmp_path: Path) -> Path:
    koala.save(make_scene(), tmp_path / "scene")
    return tmp_path / "scene"


def test_a_scene_shows_its_cameras_and_ends_on_ctrl_c(saved: Path, browse: Callable[[str], Any]) -> None:
    """The whole command with two browsers: cameras have the colours of their splits, and the image of a view appears only in the
    panel of the browser that selected it."""
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from datasets.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "view", str(saved), "--port", "0", "--quick", "--json"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        shown = json.loads(process.stdout.readline())
        assert shown["url"].startswith("http://127.0.0.1:") and shown["views"] == {"train": 6, "val": 0, "test": 3}
        window, other = browse(shown["url"]), browse(shown["url"])

        def both_colours(picture: np.ndarray) -> bool:
            return near(picture, shapes.COLOURS["train"]) > 30 and near(picture, shapes.COLOURS["test"]) > 15

        first = window.until(both_colours, "cameras in two colours")
        other.until(both_colours, "cameras in two colours")
        window.page.get_by_text("look through it").click()
        window.page.get_by_text("000.png").wait_for(timeout=1e3 * window.PATIENCE_S)
        window.until(
            lambda picture: (np.abs(picture.astype(int) - first) > 40).mean() > 0.05, "another view after 'look through it'"
        )
        assert other.page.get_by_text("000.png").count() == 0
        assert window.errors == other.errors == [] and window.outside() == other.outside() == []
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
    finally:
        process.kill()


def test_findings_are_marked_at_their_views(saved: Path) -> None:
    from datasets.page import view

    (saved / "images" / "003.png").write_bytes((saved / "images" / "002.png").read_bytes())
    scene = koala.load(saved)
    with open_page("findings", 0) as page:
        shown = view.SceneView(page, scene)
        findings = shown.add_findings(saved, matches=False)
        about = next(finding for finding in findings if "same" in finding.what)
        assert [concerned.name for concerned in view.views_of(about, scene)] == ["003"]
        mark = page.scene.get_handle_by_name(f"/findings/{findings.index(about)}/003/ball")
        assert mark is not None and np.allclose(mark.position, scene.views[3].world_from_camera[:3, 3])
        assert isinstance(mark, viser.IcosphereHandle) and tuple(mark.color) == shapes.COLOURS["warning"]


TRAJECTORY = """
format: koala-trajectory
version: 1
name: nearly
views: [{kind: orbit, target: [0.55, 0.0, 0.14], distance: 0.4, elevation_deg: 30, count: 8, roll_deg: [0, 90, 180, 270]}]
split: {train: 6, test: 2}
object: {centre: [0.55, 0.0, 0.15], size: [0.2, 0.2, 0.3]}
safety: {workspace: {centre: [0.45, 0, 0.4], size: [1.0, 1.2, 0.8]}}
"""


def test_a_trajectory_shows_the_moving_arm_and_blocked_views(tmp_path: Path, browse: Callable[[str], Any]) -> None:
    from capture.page.session import SAFETY, CaptureView
    from capture.page.timeline import of_trajectory
    from capture.rig.description import RigDescription
    from capture.trajectory import load_trajectory

    (tmp_path / "t.yaml").write_text(TRAJECTORY)
    trajectory, mount = load_trajectory(tmp_path / "t.yaml"), RigDescription().carrier()
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
        expected = mount.segments(timeline.at(timeline.end))[mount.shape.index["camera"], 0]
        handle = page.scene.get_handle_by_name("/arm/camera")
        assert handle is not None and np.allclose(handle.position, expected, atol=1e-5)
        assert window.errors == []


def test_a_calibration_shows_its_target_and_what_is_missing(browse: Callable[[str], Any]) -> None:
    """Without its recording, the page has the target, the uncertainty, and a sentence on the missing recording."""
    from calib.page.view import show

    known = UncertainPose(pose.from_rotation_vector([np.pi, 0, 0], [0.3, 0.1, 0.0]), np.diag([1e-9] * 3 + [1e-8] * 3))
    size = {"squares_x": 9, "squares_y": 7, "square_length_m": 0.03, "marker_length_m": 0.022}
    board = {"type": "charuco", **size, "dictionary": "DICT_5X5_100"}
    residuals = {"rms_px": 0.03, "corners": 100, "views_used": 9, "coverage": 0.7}
    provenance = {"board": board, "recording": "/nowhere"}
    camera = Camera(960, 540, 640.0, 640.0, 480.0, 270.0)
    calibration = Calibration(camera, {"fx": 0.1}, known, known, residuals=residuals, provenance=provenance)
    with open_page("calibration", 0) as page:
        show(page, calibration)
        window = browse(page.url)
        window.until(lambda p: near(p, (30, 30, 30)) > 200 and near(p, (235, 235, 235), 15) > 200, "dark and light squares")
        window.page.get_by_text("the recording is missing").wait_for(timeout=1e3 * window.PATIENCE_S)
        assert window.page.locator("img").count() >= 1
        window.page.get_by_text("translation: 300.000 ±").first.wait_for(timeout=1e3 * window.PATIENCE_S)
        assert window.errors == [] and window.outside() == []


@pytest.mark.parametrize(("metric", "place"), [(True, "at 1, 2, 0.5 m"), (False, "at 1, 2, 0.5")])
def test_the_caption_of_a_view_has_its_position_and_unit(make_scene: Callable[..., Scene], metric: bool, place: str) -> None:
    from dataclasses import replace

    from datasets.page.view import caption

    view = replace(make_scene().views[0], world_from_camera=pose.rigid(np.eye(3), np.array([1.0, 2.0, 0.5])), truth={})
    assert caption(view, metric=metric).endswith(place)
