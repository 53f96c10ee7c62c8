"""The whole command against the simulated controller and its protocol: stopped, killed, resumed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from koala3d.capture.cli import main
from koala3d.capture.model.rig import recorded_carrier
from koala3d.capture.page import report
from koala3d.capture.page.timeline import of_recording
from koala3d.capture.sessions.adaptive import loop
from koala3d.datasets.core import files
from koala3d.datasets.recording import CHOSEN, Recording, chosen_views

FIRST, TESTS, VIEWS = 10, 2, 16


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trajectory of 24 listed views, which are those to choose from; small pictures."""
    angles, heights = np.radians(np.arange(24) * 137.5), 0.32 + 0.012 * np.arange(24)
    places = np.stack([0.4 + 0.3 * np.cos(angles), 0.3 * np.sin(angles), heights], -1).round(4)
    poses = [{"position": place, "look_at": [0.4, 0.0, 0.14]} for place in places.tolist()]
    content = {
        "name": "listed",
        "views": [{"kind": "poses", "poses": poses, "roll_deg": [0, 90, 180, 270]}],
        "split": {"train": 22, "test": TESTS},
        "object": {"centre": [0.4, 0.0, 0.1], "size": [0.16, 0.16, 0.2]},
        "camera": {"binning": 4, "width": 64, "height": 64},
        "motion": {"speed": 1.0, "acceleration": 1.4},
    }
    path = tmp_path_factory.mktemp("room") / "listed.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def capture(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "capture")


def words_for(room: Path, out: Path, *options: str) -> list[str]:
    words = ["run", str(room), "--adaptive", "--out", str(out), "--scene", "grey_card", "--time-scale", "50"]
    return [*words, "--views", str(VIEWS), *options]


def count(out: Path) -> int:
    path = out / "frames.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def interrupted(room: Path, out: Path, frames: int, how: signal.Signals, *options: str) -> str:
    """Run until there are `frames` frames, then send a signal; returns what it printed as an error."""
    command = [sys.executable, "-m", "koala3d.capture.cli", *words_for(room, out, *options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while count(out) < frames and process.poll() is None:
            time.sleep(0.01)
        os.kill(process.pid, how)
        return process.communicate(timeout=60)[1]


@pytest.fixture(scope="module")
def resumed(room: Path, capture, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, list[str], dict, str]:
    """A session stopped by Ctrl-C in its first look, killed while it chooses, and resumed to its end."""
    out = tmp_path_factory.mktemp("adaptive") / "session"
    said = interrupted(room, out, 4, signal.SIGINT)
    early = [frame.sha256 for frame in Recording.open(out).frames]
    interrupted(room, out, FIRST + TESTS + 1, signal.SIGKILL, "--resume")
    taken = [frame.sha256 for frame in Recording.open(out).frames]
    assert taken[: len(early)] == early and 4 <= len(early) < FIRST + TESTS
    done = capture(*words_for(room, out, "--resume", "--json"))
    assert done.returncode == 0, done.stderr
    return out, said, taken, json.loads(done.stdout), done.stderr


def test_ctrl_c_says_how_to_go_on(resumed):
    assert "stopped by Ctrl-C, the arm stands still" in resumed[1] and "--resume continues" in resumed[1]


def test_a_page_shows_where_the_arm_may_go_before_it_moves(resumed):
    out, *_, said = resumed
    path = out.with_name("session.preview.html")
    lines = said.splitlines()
    told = next(number for number, line in enumerate(lines) if f"{path} shows where the arm may go" in line)
    assert told < next(number for number, line in enumerate(lines) if "resuming; first move, to view" in line)
    scene = json.loads(re.search(r"const scene = (.*);\n", path.read_text())[1])
    assert len(scene["views"]) == 1 + 24 and scene["views"][0]["name"] == "where the arm stands" and len(scene["box"]) == 12
    swept = np.array(scene["swept"])
    assert swept[:, 2].max() > 0.6 and swept[:, 2].min() > -0.05 and len(swept) > 500
    for view in scene["views"]:  # the region holds the wrist at every view
        wrist = np.array(view["arm"][0][6]).mean(axis=0)
        assert (swept.min(axis=0) - 0.05 < wrist).all() and (wrist < swept.max(axis=0) + 0.05).all()


def test_no_view_is_lost_and_none_is_taken_twice(resumed):
    out, _, taken, found, _ = resumed
    recording = Recording.open(out)
    assert [frame.name for frame in recording.frames] == [f"{index:03d}" for index in range(VIEWS)]
    assert [frame.sha256 for frame in recording.frames[: len(taken)]] == taken and len(taken) > FIRST + TESTS
    assert all(files.sha256(recording.image_path(frame)) == frame.sha256 for frame in recording.frames)
    assert not list(out.rglob(".*")) and found["frames"] == VIEWS and found["ended"] == loop.ENOUGH_VIEWS
    assert [frame.split for frame in recording.frames].count("test") == TESTS


def test_the_recording_keeps_why_each_view_was_taken(resumed, tmp_path):
    out, _, _, found, said = resumed
    recording = Recording.open(out)
    reasons = chosen_views(recording)
    assert sorted(reasons) == [frame.name for frame in recording.frames]
    kinds = [reasons[name]["kind"] for name in sorted(reasons)]
    assert kinds.count("first") == FIRST and kinds.count("test") == TESTS and kinds[FIRST + TESTS :] == ["gain"] * 4
    for frame in recording.frames:
        assert (frame.split == "test") == (reasons[frame.name]["kind"] == "test")
    last = reasons[f"{VIEWS - 1:03d}"]
    assert last["words"] in said and last["surface"] > 0 and 0 < last["covered"] < 1
    end = recording.manifest[CHOSEN]["ended"]
    assert end["reason"] == found["ended"] and end["covered"] == found["covered"] > last["covered"]
    report.write(out, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Why each view was taken" in page and last["words"] in page and loop.REASONS[end["reason"]] in page
    stops = {stop.name: stop.measured for stop in of_recording(recording, recorded_carrier(recording)).stops}
    assert last["words"] in stops[f"{VIEWS - 1:03d}"]


def test_the_recording_is_one_like_others(capture, resumed):
    checked = capture("check", resumed[0], "--json")
    findings = [one for one in json.loads(checked.stdout)["findings"] if not one["note"]]
    problems = [one for one in findings if "sharp" not in str(one)]  # a grey card has no edges
    assert not problems, problems


def test_discarded_views_are_taken_again(capture, resumed, room):
    """Two in a row, the arm far away: the path to the second is planned as well."""
    out = resumed[0]
    before = {frame.name: frame.joints for frame in Recording.open(out).frames}
    assert Recording.open(out).discard(["007", "008"]) == ["007", "008"]
    done = capture(*words_for(room, out, "--resume"))
    assert done.returncode == 0, done.stderr
    after = {frame.name: frame.joints for frame in Recording.open(out).frames}
    assert sorted(after) == sorted(before)
    for name in ("007", "008"):
        np.testing.assert_allclose(after[name], before[name], atol=1e-3)


def test_another_session_is_not_continued(capture, resumed, room, tmp_path):
    out = resumed[0]
    other = tmp_path / "other.yaml"
    other.write_text(room.read_text().replace("speed: 1.0", "speed: 1.02"))
    plain = [word for word in words_for(room, out) if word not in ("--adaptive", "--views", str(VIEWS))] + ["--resume"]
    cases = {
        tuple(words_for(other, out, "--resume")): "was taken with another trajectory",
        tuple(plain): "continue it with --adaptive",
        tuple(words_for(room, out)): str(out),
    }
    for words, message in cases.items():
        done = capture(*words)
        assert done.returncode == 2 and message in done.stderr, (words, done.stderr)
    ordinary = tmp_path / "ordinary"
    ordinary.mkdir()
    manifest = json.loads((out / "manifest.json").read_text())
    del manifest[CHOSEN]
    (ordinary / "manifest.json").write_text(json.dumps(manifest))
    done = capture(*words_for(room, ordinary, "--resume"))
    assert done.returncode == 2 and "is no session of 'capture run --adaptive'" in done.stderr
