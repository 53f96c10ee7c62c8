"""What masks say is read once: the answer is kept, and found again as long as nothing changed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.datasets.structure.masks import outlined as module
from koala3d.datasets.structure.masks.outlined import outlined


@pytest.fixture
def views(camera_ring: Callable[..., list[View]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[View]:
    """Of a white square in the middle of each picture; the cache is a new folder."""
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    mask = np.zeros((48, 64), np.uint8)
    mask[16:32, 20:44] = 255
    found = []
    for number, view in enumerate(camera_ring()):
        images.write(tmp_path / f"{number}.png", mask)
        camera = Camera(64, 48, 55, 55, 32, 24)
        found.append(replace(view, camera=camera, image=tmp_path / f"{number}.png", mask=tmp_path / f"{number}.png"))
    return found


def test_masks_are_read_once(views: list[View], monkeypatch: pytest.MonkeyPatch) -> None:
    first = outlined(views)
    assert first.box is not None and first.views_used == len(views) and not first.inverted
    with monkeypatch.context() as patch:
        patch.setattr(module, "_computed", lambda *_: pytest.fail("read again"))
        again = outlined(views)
    assert again.box is not None and np.array_equal(again.box, first.box) and (again.near, again.far) == (first.near, first.far)


def test_what_changes_the_answer_is_noticed(views: list[View]) -> None:
    first = outlined(views)
    further = [replace(view, camera=replace(view.camera, fx=80, fy=80)) for view in views]
    assert outlined(further).far != first.far
    for view in views:
        assert view.mask is not None
        images.write(view.mask, 255 - images.read_stored(view.mask))
    assert outlined(views).inverted


def test_a_damaged_answer_is_computed_again(views: list[View]) -> None:
    first = outlined(views)
    (path,) = (path for path in (views[0].image.parent / "cache").rglob("*.json"))
    path.write_text('{"box": [1, 2]}')
    assert np.array_equal(outlined(views).box, first.box)


def test_without_masks_nothing_is_kept(views: list[View], tmp_path: Path) -> None:
    assert outlined([replace(view, mask=None) for view in views]).box is None
    assert not (tmp_path / "cache").exists()
