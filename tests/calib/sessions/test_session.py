import json
import shutil

import numpy as np
import pytest

from koala3d.calib.errors import TargetError
from koala3d.calib.handeye import model
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import describe, grey, observe, observe_recording
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images


def test_recording_is_observed_view_by_view(recorded):
    path, truth = recorded
    words = []
    session = observe_recording(path, seen=words.append)
    assert (session.width, session.height) == (480, 300)
    assert [o.name for o in session.observations] == [f"{i:03d}" for i in range(11)] and session.unseen == ("011",)
    assert len(words) == 12 and words[11] == "view 011: 0 corners"
    np.testing.assert_allclose(session.base_from_flange, truth.reported[:11], atol=1e-12)
    assert len(session.provenance["frames_sha256"]) == 64 and session.provenance["board"]["squares_x"] == 11


def test_corners_are_laid_out_by_view(recorded):
    session = observe_recording(recorded[0])
    chosen = session.chosen(np.arange(11) % 2 == 0)
    assert [o.name for o in chosen.observations] == ["000", "002", "004", "006", "008", "010"]
    measured = model.measured(chosen, ("fx",), None, Accuracy())
    counts = [len(o.ids) for o in chosen.observations]
    assert np.bincount(measured.view).tolist() == counts
    np.testing.assert_array_equal(measured.pixels[measured.view == 3], chosen.observations[3].pixels)


def test_nothing_of_the_truth_is_read(recorded, tmp_path):
    copy = tmp_path / "recording"
    shutil.copytree(recorded[0], copy)
    (copy / "truth").mkdir()
    (copy / "truth" / "poses.json").write_text("{ this would fail to parse")
    assert len(observe_recording(copy).observations) == 11


def test_images_of_two_sizes_are_refused(recorded, tmp_path):
    copy = tmp_path / "recording"
    shutil.copytree(recorded[0], copy)
    images.write(copy / "images" / "004.png", np.zeros((300, 470, 3), np.uint8))
    with pytest.raises(TargetError, match=r"004\.png: image has another size than the first \(470x300, not 480x300\)"):
        observe_recording(copy)


def test_recording_without_board_or_frames_or_target_says_so(recorded, tmp_path):
    copy = tmp_path / "recording"
    shutil.copytree(recorded[0], copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    (copy / "manifest.json").write_text(json.dumps({**manifest, "board": {**manifest["board"], "dictionary": "DICT_7X7_50"}}))
    with pytest.raises(TargetError, match="12 views searched for a 11x8 charuco board with squares of 30 mm"):
        observe_recording(copy)
    (copy / "frames.jsonl").unlink()
    (copy / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(TargetError, match="holds no frames"):
        observe_recording(copy)
    (copy / "manifest.json").write_text(json.dumps({**manifest, "board": None}))
    with pytest.raises(TargetError, match="describes no calibration target"):
        observe_recording(copy)
    with pytest.raises(UsageError, match="is not a recording"):
        observe_recording(tmp_path / "nowhere")


def test_grey_leaves_alpha_out():
    picture = np.zeros((2, 2, 4), np.float32)
    picture[..., 1] = 1.0
    np.testing.assert_allclose(grey(picture), 0.587)
    np.testing.assert_array_equal(grey(picture[..., :1]), picture[..., 0])


def test_observe_needs_views(small):
    with pytest.raises(TargetError, match=describe(small.board)):
        observe(small.board, [])
