"""Paths that are made by going along them."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.page import open_page
from koala3d.reconstruct.output.camera_path import from_file
from koala3d.reconstruct.page import path_editor
from koala3d.reconstruct.page.path_editor import PathEditor

CAMERA = Camera(48, 40, 70.0, 70.0, 24.0, 20.0)


def browser_at(place: Any) -> Any:
    """As much of a browser as the editor uses, looking at the origin."""
    matrix = pose.look_at(place, (0, 0, 0))
    camera = SimpleNamespace(wxyz=pose.quaternion(matrix), position=matrix[:3, 3], fov=0.7, image_width=300, image_height=200)
    return SimpleNamespace(camera=camera, atomic=nullcontext)


@pytest.fixture
def editor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(path_editor, "LEG_S", 0.3)
    with open_page("path", 0) as page:
        yield PathEditor(page, tmp_path / "path.yaml", CAMERA, 1.0)


def test_what_is_written_is_what_film_reads(editor: PathEditor) -> None:
    places = [(1.0, 0, 0.4), (0.6, 0.9, 0.5), (-0.5, 1.0, 0.4)]
    for place in places:
        editor.add(browser_at(place))
    editor.write()
    frames, fps = from_file(editor.out)
    assert fps == path_editor.FPS and len(frames) == round(2 * 0.3 * fps)
    for frame, place in ((frames[0], places[0]), (frames[-1], places[-1])):
        assert np.allclose(frame, pose.look_at(place, (0, 0, 0)), atol=1e-5)  # rounded to a millionth in the file


def test_stops_and_curve_are_drawn_and_taken_away(editor: PathEditor) -> None:
    node = editor.page.scene.get_handle_by_name
    editor.add(browser_at((1, 0, 0.4)))
    assert node("/path/stops/0") is not None and node("/path/curve") is None
    editor.add(browser_at((0, 1, 0.4)))
    assert node("/path/stops/1") is not None and node("/path/curve") is not None
    editor.remove()
    assert node("/path/stops/1") is None and node("/path/curve") is None and node("/path/stops/0") is not None
    editor.remove()
    editor.remove()  # nothing is left
    assert editor.stops == [] and editor._status.content == "*no stops yet*" and editor.chosen.value == "none"


def test_stops_are_put_in_changed_and_taken_out_anywhere(editor: PathEditor) -> None:
    for place in ((1.0, 0, 0.4), (0.6, 0.9, 0.5), (-0.5, 1.0, 0.4)):
        editor.add(browser_at(place))
    editor.chosen.value = "1"
    editor.add(browser_at((0.9, 0.5, 0.4)))
    assert [stop.position[0] for stop in editor.stops] == pytest.approx([1.0, 0.9, 0.6, -0.5]) and editor.chosen.value == "2"
    editor.replace(browser_at((0.8, 0.6, 0.4)))
    watcher = browser_at((3, 3, 3))
    editor.go(watcher)
    assert np.allclose(watcher.camera.position, (0.8, 0.6, 0.4), atol=1e-5)
    editor.remove()
    assert [stop.position[0] for stop in editor.stops] == pytest.approx([1.0, 0.6, -0.5])
    editor.replace(None)
    editor.go(None)  # browsers that have gone


def test_a_closed_path_has_a_leg_more_and_is_taken_up_again(editor: PathEditor) -> None:
    for place in ((1.0, 0, 0.4), (0.6, 0.9, 0.5), (-0.5, 1.0, 0.4)):
        editor.add(browser_at(place))
    editor.closed.value, editor.seconds.value = True, 1.5
    assert editor.path.seconds == pytest.approx(4.5) and editor.path.closed
    editor.write()
    again = PathEditor(editor.page, editor.out, CAMERA, 1.0)
    assert again.path == editor.path and again.seconds.value == pytest.approx(1.5)
    editor.out.write_text("fps: fast")
    broken = PathEditor(editor.page, editor.out, CAMERA, 1.0)
    assert broken.stops == [] and "fps" in broken._status.content


def test_one_stop_is_no_path(editor: PathEditor) -> None:
    editor.add(None)  # a browser that has gone
    editor.add(browser_at((1, 0, 0.4)))
    editor.write()
    assert "two stops" in editor._status.content and not editor.out.exists()


def test_flying_ends_at_the_last_stop_and_when_the_page_does(editor: PathEditor) -> None:
    for place in ((1.0, 0, 0.4), (0.6, 0.9, 0.5)):
        editor.add(browser_at(place))
    watcher = browser_at((3, 3, 3))
    editor.fly(watcher)
    assert np.allclose(watcher.camera.position, (0.6, 0.9, 0.5), atol=1e-5)
    assert watcher.camera.fov == pytest.approx(2 * np.arctan(20 / 70))
    editor.page.stopping.set()
    untouched = browser_at((3, 3, 3))
    editor.fly(untouched)
    assert np.allclose(untouched.camera.position, (3, 3, 3))
