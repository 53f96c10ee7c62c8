"""Kill -9 at random moments of a run: after `--resume` the recording equals an undisturbed one."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.datasets.core import files
from koala3d.datasets.recording import Recording

pytestmark = pytest.mark.client("koala")


@pytest.fixture(autouse=True)
def chosen_client(client: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands use the client under test: for ours, ur-rtde cannot be imported."""
    if client == "koala":
        missing = tmp_path / "missing"
        missing.mkdir()
        (missing / "rtde_control.py").write_text("raise ImportError('not installed')\n")
        monkeypatch.setitem(sys.modules, "rtde_control", None)
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(missing), os.environ.get("PYTHONPATH")))))


@pytest.fixture
def finish(run_inside) -> Callable[[Path, Path], None]:
    """Runs a session to its end, inside this process."""

    def finish(trajectory: Path, out: Path) -> None:
        done = run_inside(main, "capture", *words_for(trajectory, out))
        assert done.returncode == 0, done.stderr

    return finish


def words_for(trajectory: Path, out: Path) -> list[str]:
    return ["run", str(trajectory), "--out", str(out), "--resume"]


def command(trajectory: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "koala3d.capture.cli", *words_for(trajectory, out)]


def run_whole(trajectory: Path, out: Path) -> float:
    """Run to the end; returns the seconds until the first frame was there."""
    begun, first = time.monotonic(), 0.0
    with subprocess.Popen(command(trajectory, out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        while process.poll() is None:
            if not first and (out / "frames.jsonl").exists():
                first = time.monotonic() - begun
            time.sleep(0.02)
        assert process.returncode == 0, process.stderr.read() if process.stderr else ""
    return first


def count_frames(out: Path) -> int:
    path = out / "frames.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def kill_during(trajectory: Path, out: Path, more: int, seconds: float) -> bool:
    """Start a run and kill it `seconds` after `more` frames, or three frames later; False where it ended before."""
    wanted = count_frames(out) + more
    with subprocess.Popen(command(trajectory, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while count_frames(out) < wanted and process.poll() is None:
            time.sleep(0.01)
        deadline = time.monotonic() + seconds
        while process.poll() is None and time.monotonic() < deadline and count_frames(out) < wanted + 3:
            time.sleep(0.01)
        if process.poll() is None:
            os.kill(process.pid, signal.SIGKILL)
            return True
        return False


def check_equal(killed: Path, whole: Path) -> None:
    """Same frames, each once, from the same places, with the same pictures; no temporary file is left."""
    ours, theirs = Recording.open(killed), Recording.open(whole)
    assert sorted(frame.name for frame in ours.frames) == [frame.name for frame in theirs.frames]
    assert not list(killed.rglob(".*"))
    by_name = {frame.name: frame for frame in ours.frames}
    truths = [files.read_json(path / "truth" / "poses.json")["base_from_camera"] for path in (killed, whole)]
    assert sorted(truths[0]) == sorted(truths[1])
    for frame in theirs.frames:
        same = by_name[frame.name]
        assert same.sha256 == files.sha256(ours.image_path(same)) == frame.sha256  # the very same picture
        # two readings of noisy encoders: six joints of 4 urad each, within five deviations
        np.testing.assert_allclose(same.base_from_flange, frame.base_from_flange, atol=7e-5)
        np.testing.assert_array_equal(truths[0][frame.name], truths[1][frame.name])


def test_one_kill(
    tmp_path: Path, trajectory_of: Callable[[int], Path], finish: Callable[[Path, Path], None], client: str
) -> None:
    trajectory = trajectory_of(5)
    finish(trajectory, tmp_path / "whole")
    manifest = files.read_json(tmp_path / "whole" / "manifest.json")
    assert manifest["robot"]["client"].startswith(client + " ")
    assert kill_during(trajectory, tmp_path / "killed", 2, 0.1)
    finish(trajectory, tmp_path / "killed")
    check_equal(tmp_path / "killed", tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_twenty_kills_in_a_row_in_one_recording(tmp_path: Path, trajectory_of: Callable[[int], Path]) -> None:
    trajectory = trajectory_of(80)
    first = run_whole(trajectory, tmp_path / "whole")
    rng, before = random.Random(0), []
    while len(before) < 20:
        more = rng.randrange(4)
        wait_s = rng.uniform(0.0, 0.4) if more else rng.uniform(0.0, first)  # between frames, or during the start
        assert kill_during(trajectory, tmp_path / "killed", more, wait_s), (
            "the recording was finished before it was killed 20 times"
        )
        before.append(count_frames(tmp_path / "killed"))
    assert len(set(before)) > 10  # the premise: kills struck while frames were being taken
    run_whole(trajectory, tmp_path / "killed")
    check_equal(tmp_path / "killed", tmp_path / "whole")
