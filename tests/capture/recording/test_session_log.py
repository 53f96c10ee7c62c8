"""The log of a session: what is in it, and that it survives kills, resumes and torn lines."""

import json
import logging
import os
import re
import signal
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.drivers.events import event
from koala3d.capture.recording import provenance, session_log
from koala3d.capture.recording.session_log import FINISHED, INTERRUPTED, KILLED, LOG, kept, read, sessions
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.recording import FRAMES, Recording
from tests.capture.moving import moves
from tests.moments import as_soon_as

TRAJECTORY = """\
format: koala-trajectory
version: 1
name: logged
views:
  - {kind: tilted, target: [0.40, 0.0, 0.0], distance: [0.30, 0.46], tilt_deg: [5, 40], count: 6, roll_deg: [0, 90, 180, 270]}
target: {kind: charuco, squares_x: 9, squares_y: 7, square_length_m: 0.03, marker_length_m: 0.022, dictionary: DICT_5X5_100}
board: {position: [0.265, 0.105, 0.003], rotation_deg: [180, 0, 0]}
camera: {exposure_us: 10000, binning: 4, width: 64, height: 48}
"""
LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z \d+\.\d{6} [a-z]+ \{.*\}")


@pytest.fixture
def trajectory(tmp_path: Path) -> Path:
    path = tmp_path / "logged.yaml"
    path.write_text(TRAJECTORY)
    return path


def names(recording: Path) -> list[str]:
    return [one.name for one in read(recording)]


def test_nothing_is_written_before_the_recording_is_there_and_then_everything(tmp_path):
    with kept(tmp_path, command="capture run"):
        logging.getLogger("koala3d.capture.somewhere").warning("the slider stands at %d %%", 50)
        assert not (tmp_path / LOG).exists()
        event("recording", views=3)
        event("move", joints_deg=[1.0, 2.0], speed=np.float64(0.5))
    assert names(tmp_path) == ["start", "warning", "recording", "move", "end"]
    start, warning, _, move, _ = read(tmp_path)
    assert start.facts == {"command": "capture run"} and warning.facts["text"] == "the slider stands at 50 %"
    assert move.facts == {"joints_deg": [1.0, 2.0], "speed": 0.5}
    assert all(LINE.fullmatch(line) for line in (tmp_path / LOG).read_text().splitlines())
    assert abs((datetime.now(UTC) - datetime.fromisoformat(move.at)).total_seconds()) < 60
    event("move", joints_deg=[9.0])  # the session is over
    assert len(names(tmp_path)) == 5


def test_a_session_that_never_recorded_leaves_no_file(tmp_path):
    with pytest.raises(UsageError), kept(tmp_path):
        raise UsageError("the rig is not ready")
    assert not list(tmp_path.iterdir())


def test_the_end_says_why(tmp_path):
    with kept(tmp_path):
        event("recording")
    with pytest.raises(UsageError), kept(tmp_path):
        event("recording")
        raise UsageError("the board is gone", where="view 003")
    with pytest.raises(KeyboardInterrupt), kept(tmp_path):
        event("recording")
        raise KeyboardInterrupt
    assert [one.reason for one in sessions(tmp_path)] == [FINISHED, "view 003: the board is gone", INTERRUPTED]
    assert [one.facts["kind"] for one in read(tmp_path) if one.name == "fault"] == ["UsageError"]


def test_half_a_line_does_not_spoil_the_next_one(tmp_path):
    with kept(tmp_path):
        event("recording")
    with open(tmp_path / LOG, "a") as file:
        file.write('2026-11-28T02:38:30.123456Z 12.5 move {"joi')
    with kept(tmp_path):
        event("recording")
    assert names(tmp_path) == ["start", "recording", "end", "start", "recording", "end"]
    assert [one.reason for one in sessions(tmp_path)] == [FINISHED, FINISHED]


def test_the_software_is_identified(tmp_path):
    facts = provenance.facts()
    assert (
        len(facts["source_sha256"]) == 64
        and facts["versions"]["koala-capture"]
        and facts["versions"]["opencv-contrib-python-headless"]
        and facts["process"] == os.getpid()
    )
    json.dumps(facts)
    assert provenance.commit(tmp_path) == ""
    git = ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e"]
    (tmp_path / "a").write_text("1")
    for words in (["init", "-q"], ["add", "a"], ["commit", "-qm", "first"]):
        subprocess.run([*git, *words], check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True).stdout.strip()
    assert provenance.commit(tmp_path) == head
    (tmp_path / "venv").mkdir()
    assert provenance.commit(tmp_path / "venv") == ""  # installed below another project
    (tmp_path / "a").write_text("2")
    assert provenance.commit(tmp_path) == f"{head}-dirty"


def test_a_killed_session_leaves_whole_lines_and_its_resume_a_trace(tmp_path, trajectory, run_inside):
    out = tmp_path / "rec"
    words = ["run", str(trajectory), "--out", str(out)]
    command = [sys.executable, "-m", "koala3d.capture.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while not (out / FRAMES).exists() or (out / FRAMES).read_bytes().count(b"\n") < 2:
            assert process.poll() is None
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)
    assert all(LINE.fullmatch(line) for line in (out / LOG).read_text().splitlines())
    (killed,) = sessions(out)
    assert killed.reason == KILLED and killed.pictures >= 1  # the line of a picture follows that of its frame
    assert killed.facts["resume"] is False and str(trajectory) in killed.facts["command"]
    before = (out / LOG).read_bytes()

    done = run_inside(main, "capture", *words, "--resume")
    assert done.returncode == 0, done.stderr
    assert (out / LOG).read_bytes().startswith(before)
    first, second = sessions(out)
    assert (first.reason, second.reason, second.facts["resume"]) == (KILLED, FINISHED, True)
    assert first.ended < second.begun and second.pictures == 6 - _taken(out)
    pictures = [one for one in read(out) if one.name == "picture"]
    frames = Recording.open(out).frames
    assert {one.facts["view"]: one.facts["wall_time"] for one in pictures}.items() <= {
        f.name: f.wall_time for f in frames
    }.items()
    move = next(one for one in read(out) if one.name == "move")
    assert len(move.facts["joints_deg"]) == 6 and move.facts["speed"] == 0.1, "the first move is slow"
    (rig, *_) = [one.facts for one in read(out) if one.name == "rig"]
    assert rig["robot"]["software"] and rig["robot"]["client"] and rig["cameras"][0]["model"]

    checked = run_inside(main, "capture", "check", str(out))
    assert f"session from {first.begun} to {first.ended} by " in checked.stdout and " views, killed\n" in checked.stdout


def _taken(out: Path) -> int:
    """How many views the newest session found."""
    return [one for one in read(out) if one.name == "recording"][-1].facts["taken"]


def test_a_protective_stop_is_in_the_log_and_names_what_to_read(tmp_path, trajectory, run_inside):
    with SimulatedController.start(seed=4, time_scale=5.0) as controller:
        write_simulated_rig(tmp_path / "rig.yaml", controller, "board", 4)
        words = ["capture", "run", str(trajectory), "--rig", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "rec")]
        recorded = lambda: (tmp_path / "rec" / FRAMES).exists() and moves(controller)  # noqa: E731
        with as_soon_as(recorded, lambda: controller.ask("protective_stop"), "a motion after the first view"):
            done = run_inside(main, *words)
    assert done.returncode == 1 and "docs/recovery.md" in done.stderr
    (session,) = sessions(tmp_path / "rec")
    assert "protective stop" in session.reason and session.pictures >= 1
    assert [one.facts["kind"] for one in read(tmp_path / "rec") if one.name == "fault"] == ["ProtectiveStop"]


def test_the_end_is_on_the_disk(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(session_log.os, "fsync", lambda handle: flushed.append(os.fstat(handle).st_size))
    with kept(tmp_path):
        event("recording")
        event("move")
        written = len(flushed)
    assert written == 1 and len(flushed) == 2 and flushed[-1] == (tmp_path / LOG).stat().st_size
