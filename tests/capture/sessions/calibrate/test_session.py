"""The whole command against the simulated controller and its protocol, with small pictures: stopped, killed, resumed."""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from koala3d.capture.cli import main
from koala3d.capture.sessions.calibrate import loop, session
from koala3d.capture.sessions.calibrate.loop import AccuracyGoal, CalibrationOutcome
from koala3d.datasets.advice import Answer
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core import files
from koala3d.datasets.recording import Recording

SMALL = [f"--set=camera.{value}" for value in ("binning=4", "width=480", "height=270")]
VIEWS = 7


@pytest.fixture(scope="module")
def capture(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "capture")


def words_for(out: Path, *options: str) -> list[str]:
    never = ["--until-mm", "0.001", "--until-deg", "0.0001", "--max-views", str(VIEWS)]
    return ["calibrate", "--out", str(out), "--time-scale", "50", *never, *SMALL, *options]


def count(out: Path) -> int:
    path = out / "frames.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def interrupted(out: Path, frames: int, how: signal.Signals, *options: str) -> str:
    """Run until there are `frames` frames, then send a signal; returns what it printed as an error."""
    command = [sys.executable, "-m", "koala3d.capture.cli", *words_for(out, *options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while count(out) < frames and process.poll() is None:
            time.sleep(0.01)
        os.kill(process.pid, how)
        return process.communicate(timeout=60)[1]


@pytest.fixture(scope="module")
def resumed(capture, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, list[str], dict]:
    """A session stopped by Ctrl-C after two views, killed after four, and resumed to its end."""
    out = tmp_path_factory.mktemp("calibrate") / "session"
    said = interrupted(out, 2, signal.SIGINT)
    early = [frame.sha256 for frame in Recording.open(out).frames]
    interrupted(out, 4, signal.SIGKILL, "--resume")
    taken = [frame.sha256 for frame in Recording.open(out).frames]
    assert taken[: len(early)] == early
    done = capture(*words_for(out, "--resume", "--json"))
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"view {VIEWS - 1:03d}:")
    assert "session.preview.html shows where the arm may go" in done.stderr and out.with_name("session.preview.html").is_file()
    return out, said, taken, json.loads(done.stdout)


def test_ctrl_c_says_how_to_go_on(resumed):
    assert "stopped by Ctrl-C, the arm stands still" in resumed[1] and "--resume continues" in resumed[1]


def test_no_view_is_lost_and_none_is_taken_twice(resumed):
    out, _, taken, _ = resumed
    recording = Recording.open(out)
    assert [frame.name for frame in recording.frames] == [f"{index:03d}" for index in range(VIEWS)]
    assert [frame.sha256 for frame in recording.frames[: len(taken)]] == taken and len(taken) >= 4
    assert all(files.sha256(recording.image_path(frame)) == frame.sha256 for frame in recording.frames)
    assert not list(out.rglob(".*"))
    (group,) = recording.trajectory["views"]
    assert group["kind"] == "joints" and len(group["joints_deg"]) == VIEWS


@pytest.mark.slow  # on a busy machine the small pictures may show too little of the board
def test_the_calibration_is_written_and_true(resumed):
    out, _, _, found = resumed
    assert found["reason"] == loop.ENOUGH_VIEWS and found["views"] == VIEWS
    assert found["what_would_help"][-1].startswith("more views: about")
    calibration = Calibration.load(out / "calibration.json")
    truth = json.loads((out / "truth" / "poses.json").read_text())["flange_from_camera"]
    assert calibration.flange_from_camera is not None
    distance = sum((calibration.flange_from_camera.matrix[i, 3] - truth[i][3]) ** 2 for i in range(3)) ** 0.5
    assert 1e3 * distance < found["error_mm_95"]


@pytest.mark.slow  # the same: a picture may be blurred
def test_the_recording_is_one_like_others(capture, resumed):
    out = resumed[0]
    checked = capture("check", out)
    assert checked.returncode == 0 and "nothing is wrong" in checked.stdout, checked.stdout
    again = capture(*words_for(out))
    assert again.returncode == 2 and str(out) in again.stderr  # without --resume it is refused


def test_a_session_of_another_kind_is_not_continued(capture, resumed, tmp_path):
    out, other = resumed[0], tmp_path / "other"
    other.mkdir()
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["trajectory"]["views"] = [{"kind": "poses", "poses": [{"position": [0.4, 0, 0.3], "look_at": [0.4, 0, 0]}]}]
    (other / "manifest.json").write_text(json.dumps(manifest))
    done = capture(*words_for(other, "--resume"))
    assert done.returncode == 2 and "is no session of 'capture calibrate'" in done.stderr


def test_bars_vanish_as_the_wanted_error_is_reached():
    assert session.bar(1.0) == session.bar(0.5) == "." * session.BAR and session.bar(1000.0) == "#" * session.BAR
    assert session.bar(30**0.5).count("#") == session.BAR // 2


@pytest.mark.parametrize("reason", loop.REASONS)
def test_every_end_is_told_in_words(reason):
    goal = AccuracyGoal((0.05, 0.01))
    figures = (0.04, 0.009) if reason == loop.REACHED else (0.2, 0.05)
    answer = Answer(views=9, figures=figures, calibration="session/calibration.json", hints=["more tilt: about half"])
    said = session.describe(Path("session"), CalibrationOutcome(reason, answer), goal)
    assert loop.REASONS[reason] in said and f"{figures[0]:.4f} mm" in said
    assert ("what would help" in said) == (reason != loop.REACHED)
    nothing = session.describe(Path("session"), CalibrationOutcome(loop.NOT_FOUND, Answer()), goal)
    assert "no view shows the board" in nothing and "kept in session" in nothing
