"""`calib handeye` on pictures of several targets: one target in two recordings, and two targets in each picture of one."""

import json
from functools import partial

import numpy as np
import pytest

from koala3d.calib.cli import main
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.core import files
from koala3d.datasets.targets.board import Board

TAGS = Board.of("tags", 4, 2, 0.05, 0.04, "DICT_4X4_50")


@pytest.fixture(scope="module")
def calib(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "calib")


@pytest.fixture(scope="module")
def both_in_one(tmp_path_factory, make_recording):
    """(recording, its truth, pose of the tags) of pictures that show the board and, beside it, a strip of tags that is tilted."""
    path = tmp_path_factory.mktemp("boards") / "both"
    base_from_tags = pose.from_rotation_vector([np.pi - 0.3, 0.0, 0.0], [0.42, -0.14, 0.01])
    return path, make_recording(path, views=10, beside=(TAGS, base_from_tags)), base_from_tags


def test_two_targets_in_one_recording(calib, both_in_one, tmp_path):
    recording, truth, base_from_tags = both_in_one
    for name, board in (("charuco", truth.board), ("tags", TAGS)):
        files.write_text(tmp_path / f"{name}.yaml", "".join(f"{key}: {value}\n" for key, value in board.model_dump().items()))
    chosen = ["--board", tmp_path / "charuco.yaml", "--board", tmp_path / "tags.yaml"]
    result = calib("handeye", recording, *chosen, "--out", tmp_path / "calibration.json")
    assert result.returncode == 0, result.stderr
    assert "tags.yaml: " in result.stdout and "placed to" in result.stdout
    calibration = Calibration.load(tmp_path / "calibration.json")
    assert calibration.residuals.views_used == 10  # pictures, not sessions
    charuco, tags = calibration.residuals.boards
    assert charuco["views"] == 10 and tags["views"] >= 3
    placed = UncertainPose.from_json(tags["base_from_board"], where="tags")
    distance, _ = pose.difference(placed.matrix, base_from_tags)
    assert 1e3 * distance < 4 * placed.total_std[0]  # four deviations
    distance, _ = pose.difference(calibration.flange_from_camera.matrix, truth.flange_from_camera)
    assert 1e3 * distance < 4 * calibration.flange_from_camera.total_std[0]


def test_one_target_in_two_recordings(calib, recorded, recorded_again, tmp_path):
    result = calib("handeye", recorded[0], recorded_again[0], "--out", tmp_path / "calibration.json", "--json")
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert [board["views"] for board in found["residuals"]["boards"]] == [11, 8]
    assert found["residuals"]["views_used"] == 19


def test_targets_that_look_alike_are_refused(calib, recorded, tmp_path):
    files.write_text(
        tmp_path / "tags.yaml", "kind: tags\nsquares_x: 2\nsquares_y: 2\nsquare_length_m: 0.05\nmarker_length_m: 0.04\n"
    )
    chosen = ["--board", "charuco", "--board", tmp_path / "tags.yaml"]
    result = calib("handeye", recorded[0], *chosen, "--out", tmp_path / "calibration.json")
    assert result.returncode == 2 and "two targets look alike" in result.stderr and "marker 0 of DICT_5X5_100" in result.stderr
    chosen = ["--board", "charuco", "--board", "chessboard"]
    result = calib("handeye", recorded[0], *chosen, "--out", tmp_path / "calibration.json")
    assert result.returncode == 2 and "one of them has no markers" in result.stderr
    assert not (tmp_path / "calibration.json").exists()
