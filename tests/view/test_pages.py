"""The pages in a browser, one test per command: content is visible, a click changes it, Ctrl-C ends them."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import koala
from koala3d.datasets.page import open_page, shapes
from koala3d.datasets.residuals import Residuals
from koala3d.datasets.scene import Scene
from tests.browser import Browse

pytestmark = pytest.mark.timeout(600)


def near(picture: np.ndarray, colour: tuple[int, int, int], tolerance: int = 40) -> int:
    """Number of pixels close to a colour; lines are blended with the background."""
    return int((np.abs(picture.astype(int) - colour).max(-1) < tolerance).sum())


def changed(picture: np.ndarray, before: np.ndarray) -> float:
    """Share of the pixels that differ clearly."""
    return float((np.abs(picture.astype(int) - before) > 40).any(-1).mean())


def test_a_command_serves_several_browsers_and_ends_on_ctrl_c(
    make_scene: Callable[..., Scene], tmp_path: Path, browse: Browse
) -> None:
    """The image of a view appears only in the panel of the browser that selected it."""
    koala.save(make_scene(), tmp_path / "scene")
    code = "from koala3d.datasets.cli import main; main()"
    command = [sys.executable, "-c", code, "view", str(tmp_path / "scene"), "--port", "0", "--quick", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        shown = json.loads(process.stdout.readline())
        assert shown["url"].startswith("http://127.0.0.1:") and shown["views"] == {"train": 6, "val": 0, "test": 3}
        left = "WebSocket connection to .* failed"  # the page waits for its command to come back
        with browse(shown["url"], expected=left) as window, browse(shown["url"], expected=left) as other:
            other.page.get_by_text("look through it").wait_for()
            window.page.get_by_text("look through it").click()
            window.page.get_by_text("000.png").wait_for()
            assert other.page.get_by_text("000.png").count() == 0
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=20) == 0
    finally:
        process.kill()


def test_a_scene_shows_its_cameras_and_is_measured(make_scene: Callable[..., Scene], browse: Browse) -> None:
    """Cameras have the colours of their splits; the ruler takes the one point, on which all cameras look."""
    from koala3d.datasets.reports.page.view import SceneView

    with open_page("scene", 0) as page:
        SceneView(page, replace(make_scene(), points=np.zeros((1, 3)))).add_thumbnails()
        with browse(page) as window:

            def both_colours(picture: np.ndarray) -> bool:
                return near(picture, shapes.COLOURS["train"]) > 30 and near(picture, shapes.COLOURS["test"]) > 15

            first = window.until(both_colours, "cameras in two colours")
            window.page.get_by_text("look through it").click()
            window.until(lambda picture: changed(picture, first) > 0.05, "another view after 'look through it'")
            window.page.get_by_label("measure", exact=True).click()
            window.page.get_by_text("click two points").wait_for()
            window.click_scene()
            window.page.get_by_text("click another point").wait_for()


TRAJECTORY = """
format: koala-trajectory
version: 1
name: nearly
views: [{kind: orbit, target: [0.55, 0.0, 0.14], distance: 0.4, elevation_deg: 30, count: 8, roll_deg: [0, 90, 180, 270]}]
split: {train: 6, test: 2}
object: {centre: [0.55, 0.0, 0.15], size: [0.2, 0.2, 0.3]}
safety: {workspace: {centre: [0.45, 0, 0.4], size: [1.0, 1.2, 0.8]}}
"""


def test_a_trajectory_shows_the_moving_arm_and_blocked_views(tmp_path: Path, browse: Browse) -> None:
    from koala3d.capture.model.rig import RigDescription
    from koala3d.capture.model.trajectory import load_trajectory
    from koala3d.capture.page.session import SAFETY, CaptureView
    from koala3d.capture.page.timeline import of_trajectory

    (tmp_path / "t.yaml").write_text(TRAJECTORY)
    trajectory, mount = load_trajectory(tmp_path / "t.yaml"), RigDescription().carrier()
    timeline = of_trajectory(trajectory, mount)
    blocked = [stop for stop in timeline.stops if stop.reason]
    assert blocked and len(blocked) < 8
    with open_page("arm", 0) as page:
        shown = CaptureView(page, trajectory, mount, timeline)
        with browse(page) as window:
            before = window.until(
                lambda p: near(p, SAFETY, 60) > 30 and near(p, shapes.COLOURS["blocked"]) > 10, "volumes and views"
            )
            window.page.get_by_text(blocked[0].reason).first.wait_for()
            play = window.page.get_by_label("play", exact=True)
            play.click()
            window.page.get_by_text(f"0.0 of {timeline.end:.1f} s").wait_for(state="hidden")
            window.until(lambda picture: changed(picture, before) > 0.005, "the arm elsewhere")
            play.click()
            assert shown.slider.value > 0


def test_a_calibration_shows_its_target_and_what_is_missing(browse: Browse) -> None:
    """Without its recording, the page has the target, the uncertainty, and a sentence on the missing recording."""
    from koala3d.calib.page.view import show

    known = UncertainPose(pose.from_rotation_vector([np.pi, 0, 0], [0.3, 0.1, 0.0]), np.diag([1e-9] * 3 + [1e-8] * 3))
    size = {"squares_x": 9, "squares_y": 7, "square_length_m": 0.03, "marker_length_m": 0.022}
    board = {"type": "charuco", **size, "dictionary": "DICT_5X5_100"}
    residuals = Residuals(rms_px=0.03, corners=100, views_used=9, coverage=0.7)
    provenance = {"board": board, "recording": "/nowhere"}
    camera = Camera(960, 540, 640.0, 640.0, 480.0, 270.0)
    calibration = Calibration(camera, {"fx": 0.1}, known, known, residuals=residuals, provenance=provenance)
    with open_page("calibration", 0) as page:
        show(page, calibration)
        with browse(page) as window:
            window.until(lambda p: near(p, (30, 30, 30)) > 200 and near(p, (235, 235, 235), 15) > 200, "dark and light squares")
            window.page.get_by_text("the recording is missing").wait_for()
            window.page.get_by_text("translation: 300.000 ±").first.wait_for()
            figure = window.page.locator("img").first
            before = figure.get_attribute("src")
            window.choose("figure", "uncertainty of base_from_board")
            window.page.wait_for_function("before => document.querySelector('img').src != before", arg=before)


def test_masks_are_painted_with_a_brush_and_cut_again(make_scene: Callable[..., Scene], tmp_path: Path, browse: Browse) -> None:
    """A click on the picture is a green dot; the scene is cut with it and written."""
    from koala3d.datasets.segmentation.grow import Grower
    from koala3d.datasets.segmentation.page.brush import COLOURS, MaskPage

    grower = Grower(make_scene())
    with open_page("masks", 0) as page:
        MaskPage(page, grower, grower.grow(), [], tmp_path / "out")
        with browse(page) as window:
            window.until(lambda picture: picture.mean() < 128, "the picture, which is dark")
            window.click_scene()
            window.page.get_by_text("1 dot of the brush").wait_for()
            window.until(lambda picture: near(picture, COLOURS["object"]) > 20, "a green dot")
            window.page.get_by_text("undo").click()
            window.page.get_by_text("0 dots of the brush").wait_for()
            window.page.get_by_text("write the scene").click()
            window.page.get_by_text("written to").wait_for()
    assert koala.load(tmp_path / "out").views[0].mask is not None
