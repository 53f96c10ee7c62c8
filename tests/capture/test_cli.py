import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from datasets import files
from datasets.recording import Recording

SESSION = """\
format: koala-trajectory
version: 1
name: three
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [40, 60], azimuth_deg: [150, 210], rings: 1,
     count: COUNT, roll_deg: [0, 90, 180, 270]}
split: {train: TRAIN, test: 1}
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 4, width: 48, height: 48}
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = tmp_path / "three.yaml"
    path.write_text(SESSION.replace("COUNT", "3").replace("TRAIN", "2"))
    return path


def capture(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "capture.cli", *map(str, arguments)]
    environment = {**os.environ, "KOALA_RENDERER": "scalar_rgb"}
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)


def test_records_a_session_and_refuses_to_overwrite_it(session, tmp_path):
    done = capture("run", session, "--scene", "shiny_ball", "--out", tmp_path / "rec", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 3
    recording = Recording.open(tmp_path / "rec")
    assert [frame.split for frame in recording.frames].count("test") == 1 and recording.manifest["scene"] == "shiny_ball"
    poses = files.read_json(tmp_path / "rec" / "truth" / "poses.json")
    assert sorted(poses["base_from_camera"]) == [frame.name for frame in recording.frames]
    again = capture("run", session, "--out", tmp_path / "rec")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1) and "already exists" in again.stderr


def test_ctrl_c_keeps_what_was_taken_and_says_how_to_go_on(tmp_path):
    path = tmp_path / "many.yaml"
    path.write_text(SESSION.replace("COUNT", "12").replace("TRAIN", "11"))
    out = tmp_path / "rec"
    command = [sys.executable, "-m", "capture.cli", "run", str(path), "--scene", "shiny_ball", "--out", str(out)]
    environment = {**os.environ, "KOALA_RENDERER": "scalar_rgb"}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True
    )
    deadline = time.monotonic() + 90
    while not (out / "frames.jsonl").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group
    words = process.communicate(timeout=60)[1]
    assert process.returncode == 1 and words.count("error:") == 1 and "--resume" in words, words
    before = len(Recording.open(out).frames)
    assert 1 <= before < 12
    done = capture("run", path, "--scene", "shiny_ball", "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    names = [frame.name for frame in Recording.open(out).frames]
    assert len(names) == len(set(names)) == 12


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        (("binning", "binnning"), [], "line 9: unknown key 'camera.binnning'; did you mean 'binning'?"),
        (("", ""), ["--scene", "gold_hed"], "unknown scene 'gold_hed'; did you mean 'gold_head'?"),
        (("", ""), ["--scene", "charuco_board"], "needs a trajectory with 'target'"),
        (("", ""), ["--rig", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (("distance: 0.4", "distance: 2.0"), [], "views cannot be taken"),
        (("width: 48", "width: wide"), [], "camera.width"),
    ],
)
def test_misuse_is_one_line_and_leaves_nothing(session, tmp_path, change, arguments, words):
    session.write_text(session.read_text().replace(*change))
    done = capture("run", session, "--out", tmp_path / "rec", *arguments)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and words in done.stderr, done.stderr
    assert not (tmp_path / "rec").exists()


def test_camera_that_refuses_leaves_nothing(session, tmp_path):
    session.write_text(session.read_text().replace("binning: 4", "binning: 5"))
    done = capture("run", session, "--scene", "shiny_ball", "--out", tmp_path / "rec")
    assert done.returncode == 1 and "BinningHorizontal (requested 5" in done.stderr
    assert not (tmp_path / "rec").exists()


def test_plan_says_whether_all_can_be_taken(session):
    done = capture("plan", session, "--json")
    assert done.returncode == 0
    content = json.loads(done.stdout)
    assert content["splits"] == {"train": 2, "test": 1} and 1 < content["seconds"] < 60


def test_help_is_instant():
    start = time.monotonic()
    done = capture("--help")
    assert done.returncode == 0 and "run" in done.stdout and "plan" in done.stdout
    assert time.monotonic() - start < 3  # far above the 0.2 s that it takes, far below what numpy and trimesh would
