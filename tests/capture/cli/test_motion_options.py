"""Options that slow the arm down, ask before it moves, or drive it without a recording: the whole command, on a real terminal."""

import json
import os
import pty
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from koala3d.capture.cli import main
from koala3d.capture.cli import run as run_module
from koala3d.capture.sessions.start import SessionOptions
from koala3d.datasets.recording import Recording

SESSION = """\
name: two
views: [{kind: joints, joints_deg: [[0, -90, 90, -90, -90, 0], [4, -90, 90, -90, -90, 10]]}]
camera: {binning: 4, width: 48, height: 48}
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = tmp_path / "two.yaml"
    path.write_text(SESSION)
    return path


@pytest.fixture(scope="session")
def capture(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "capture")


def on_a_terminal(answers: str, *words: object) -> tuple[int, str]:
    """Exit status and what is printed by a command whose standard input is a terminal on which somebody has typed ahead."""
    typed, terminal = pty.openpty()
    try:
        os.write(typed, answers.encode())
        command = [sys.executable, "-m", "koala3d.capture.cli", *map(str, words)]
        done = subprocess.run(command, stdin=terminal, capture_output=True, text=True, timeout=300)
    finally:
        os.close(typed)
        os.close(terminal)
    return done.returncode, done.stderr


def test_each_move_is_asked_for_and_the_session_ends_where_a_person_says_so(session: Path, tmp_path: Path, capture) -> None:
    out = tmp_path / "rec"
    words = ["run", session, "--scene", "grey_card", "--out", out]
    status, said = on_a_terminal("what?\ny\nstop\n", *words, "--confirm")
    assert status == 1 and said.count("move? y: yes; all: this one and all others; stop: end here") == 3
    assert "view 000: joint 3 by" in said and "at most 0.10 rad/s" in said and "mm from the nearest thing" in said
    assert "view 001: joint 1 by 4, joint 6 by 10 degrees" in said and "before view 001: ended at the terminal" in said
    assert [frame.name for frame in Recording.open(out).frames] == ["000"]
    status, said = on_a_terminal("all\n", *words, "--confirm", "--resume", "--slow", "0.5")
    assert status == 0 and "resuming; first move, to view 001: no joint faster than 0.1 rad/s" in said, said
    assert len(Recording.open(out).frames) == 2
    done = capture(*words, "--resume")
    assert done.returncode == 0, "a recording is the same session at any speed"


def test_without_a_terminal_nothing_is_asked_and_nothing_begins(session: Path, tmp_path: Path, capture) -> None:
    command = [
        sys.executable,
        "-m",
        "koala3d.capture.cli",
        "run",
        str(session),
        "--scene",
        "grey_card",
        "--out",
        str(tmp_path / "rec"),
        "--confirm",
    ]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "no terminal to ask on" in done.stderr
    assert not (tmp_path / "rec").exists()


def test_a_dry_run_moves_the_arm_and_records_nothing(session: Path, tmp_path: Path, capture, monkeypatch) -> None:
    monkeypatch.setattr("koala3d.capture.sim.camera.SimulatedCamera.__enter__", None)  # no camera is opened
    monkeypatch.chdir(tmp_path)
    done = capture("run", session, "--scene", "grey_card", "--dry-run", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["views"] == 2 and "first move, to view 000" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["two.yaml"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--out: no recording is named; name a new folder, or add --dry-run"),
        (["--dry-run", "--out", "rec"], "--out: means nothing to a dry run"),
        (["--dry-run", "--adaptive"], "--adaptive: means nothing to a dry run"),
    ],
)
def test_either_a_recording_or_a_dry_run_is_wanted(session: Path, capture, options: list[str], words: str) -> None:
    done = capture("run", session, *options)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and words in done.stderr


def test_a_slow_session_is_slow(session: Path, tmp_path: Path, capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `--slow` says reaches the session's options, and nothing else does in its place."""
    seen: list[SessionOptions] = []
    monkeypatch.setattr(run_module, "_every", lambda trajectory, out, options, port: seen.append(options) or ({}, ""))
    done = capture("run", session, "--scene", "grey_card", "--out", tmp_path / "rec", "--slow", "0.25")
    assert done.returncode == 0, done.stderr
    assert (seen[0].slow, seen[0].ignore) == (0.25, ())
