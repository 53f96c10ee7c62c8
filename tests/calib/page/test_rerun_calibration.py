"""A calibration in a file of Rerun, read back by Rerun: poses, pictures, corners and errors of every view."""

from functools import partial

import cv2
import numpy as np
import pytest

from koala3d.calib.cli import main
from koala3d.calib.page.evidence import gather
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.recording import Recording
from tests import rrd


@pytest.fixture(scope="module")
def calib(run_inside):
    return partial(run_inside, main, "calib")


@pytest.fixture(scope="module")
def written(calib, recorded, tmp_path_factory):
    """(what the file holds, the calibration)."""
    pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")
    folder = tmp_path_factory.mktemp("rerun")
    out = folder / "c.json"
    done = calib("handeye", recorded[0], "--out", out, "--rerun", folder / "session.rrd")
    assert done.returncode == 0, done.stderr
    return rrd.read(folder / "session.rrd", "view"), Calibration.load(out)


def test_cameras_are_where_the_arm_says(written, recorded):
    found, calibration = written
    frames = Recording.open(recorded[0]).frames[:11]  # the last view shows no target
    places, turns = (found[f"/base/camera Transform3D:{name}"] for name in ("translation", "mat3x3"))
    assert [when for when, _ in places] == list(range(11))
    for frame, (_, place), (_, turn) in zip(frames, places, turns, strict=True):
        expected = frame.base_from_flange @ calibration.flange_from_camera.matrix
        assert np.allclose(place[0], expected[:3, 3], atol=1e-6)  # Rerun stores float32
        assert np.allclose(np.reshape(turn[0], (3, 3)).T, expected[:3, :3], atol=1e-6)  # column by column


def test_the_board_is_where_it_stands(written):
    found, calibration = written
    assert np.allclose(found["/base/board Transform3D:translation"][0][1], calibration.base_from_board.matrix[:3, 3], atol=1e-6)
    plate = np.array(found["/base/board/plate Mesh3D:vertex_positions"][0][1])
    assert np.allclose(plate.max(0)[:2], [0.33, 0.24])  # 11 x 8 squares of 30 mm


def test_pictures_corners_and_residuals(written, observed):
    found, calibration = written
    evidence = gather(calibration, observed)
    pictures = found["/base/camera/picture EncodedImage:blob"]
    assert len(pictures) == 11
    decoded = cv2.imdecode(np.array(pictures[0][1][0], np.uint8), cv2.IMREAD_COLOR)
    size = found["/base/camera Pinhole:resolution"][0][1][0]
    assert decoded.shape[:2] == (size[1], size[0]) == (calibration.camera.height, calibration.camera.width)
    for number, sighting in enumerate(evidence.sightings()):
        corners = np.array(found["/base/camera/corners/found Points2D:positions"][number][1])
        arrows = np.array(found["/base/camera/corners/residuals Arrows2D:vectors"][number][1])
        assert np.allclose(corners, sighting.pixels, atol=1e-3)
        assert np.allclose(arrows, sighting.residuals[evidence.kind], atol=1e-4)
    (curve,) = (key for key in found if key.startswith(f"/rms_px/{evidence.kind.replace(' ', '_')} "))
    assert len(found[curve]) == 11


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rerun", "{tmp}/session.txt"], "end the name in .rrd"),
        (["--rerun", "{tmp}/there.rrd"], "already exists"),
        (["{recording}", "--rerun", "{tmp}/new.rrd"], "shows a session with one target"),
    ],
)
def test_misuse_is_noticed_before_the_work_begins(calib, recorded, tmp_path, words, message):
    pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")
    (tmp_path / "there.rrd").write_text("")
    words = [word.format(tmp=tmp_path, recording=recorded[0]) for word in words]
    done = calib("handeye", recorded[0], *words, "--out", tmp_path / "c.json")
    assert done.returncode == 2 and message in done.stderr, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["there.rrd"]
