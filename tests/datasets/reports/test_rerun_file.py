"""Rerun's file itself: complete after an error, in Rerun's conventions, and refused at once if it cannot be written."""

import sys
from pathlib import Path

import numpy as np
import pytest

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.extras import not_installed
from koala3d.datasets.imaging import images
from koala3d.datasets.reports.rerun_file import SIDE, require, rerun_file
from tests import rrd

pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")


def test_what_was_logged_before_an_error_is_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), rerun_file(tmp_path / "f.rrd", "test") as shown:
        shown.at(step=3)
        shown.numbers("loss", {"total": 0.5})
        raise KeyboardInterrupt
    assert rrd.read(tmp_path / "f.rrd", "step")["/loss/total Scalars:scalars"] == [(3, [0.5])]
    assert [path.name for path in tmp_path.iterdir()] == ["f.rrd"]


def test_large_pictures_are_shrunk_with_their_cameras(tmp_path: Path) -> None:
    """A ray through a pixel of the small picture is that through the same place of the large one."""
    camera = Camera(4 * SIDE, 2 * SIDE, 3000.0, 3100.0, 1900.0, 980.0)
    images.write(tmp_path / "p.png", np.zeros((camera.height, camera.width, 3), np.uint8))
    with rerun_file(tmp_path / "f.rrd", "test") as shown:
        shown.camera("camera", camera)
        shown.picture("camera/picture", tmp_path / "p.png", camera)
        shown.corners("camera/corners", [[400.0, 800.0]], None, camera)
    found = rrd.read(tmp_path / "f.rrd", "view")
    assert found["/camera Pinhole:resolution"][0][1][0] == [SIDE, SIDE / 2]
    assert np.allclose(found["/camera Pinhole:image_from_camera"][0][1][0], [750, 0, 0, 0, 775, 0, 475, 245, 1])  # by columns
    assert found["/camera/corners/found Points2D:positions"][0][1] == [[100.0, 200.0]]
    assert found["/camera Pinhole:camera_xyz"][0][1][0] == [3, 2, 5]  # right, down, forward


def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require(None)
    with pytest.raises(UsageError, match=r"end the name in \.rrd"):
        require(tmp_path / "f.txt")
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ModuleNotFoundError) as raised:
        require(tmp_path / "f.rrd")
    assert "koala-capture[rerun]" in str(not_installed(raised.value))
