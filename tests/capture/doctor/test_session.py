"""What the examination means for a session: silence, warnings, or a refusal before anything moves; programs that run."""

import json
import logging
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.doctor.examine import examination, examine
from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.drivers.errors import NotReady
from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard
from koala3d.capture.drivers.ur.robot import UniversalRobot
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.rig.naming import describe
from koala3d.capture.sim.controller.process import SimulatedController

SESSION = """\
format: koala-trajectory
version: 1
name: one
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [40, 60], azimuth_deg: [150, 210], rings: 1,
     count: 3, roll_deg: [0, 90, 180, 270]}
split: null
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 4, width: 48, height: 48}
"""


@pytest.fixture
def simulated():
    with SimulatedController.as_built(seed=3, time_scale=20.0) as controller:
        yield controller


def state(host: str) -> str:
    dashboard = Dashboard.connect(host)
    try:
        return dashboard.ask("programState")
    finally:
        dashboard.close()


def test_a_session_on_a_good_rig_starts_in_silence(simulated, tmp_path, caplog):
    with caplog.at_level(logging.INFO):
        examination(tmp_path / "rec", 1, True, False)(RigDescription(), simulated.host, True)
    assert not caplog.text


def test_each_camera_of_a_rig_has_its_lines(simulated, tmp_path):
    lines = examine(describe("ur5e_stereo"), simulated.host, tmp_path, simulated=True, seconds=0.1)
    found = {line.name: line for line in lines}
    assert len(found) == len(lines)
    assert [found[f"{name} camera serial"].found for name in ("left", "right")] == ["0815-0000", "0815-0001"]
    assert "write cameras.right.serial: '0815-0001' into the rig file" in found["right camera serial"].remedy
    assert not [line.name for line in lines if "camera" in line.name and line.verdict is Verdict.WRONG]


def test_what_makes_a_recording_worse_is_a_warning(simulated, tmp_path, caplog):
    simulated.ask("safety", mode="REDUCED")
    examination(tmp_path / "rec", 1, True, False)(RigDescription(), simulated.host, True)
    assert "reduced mode: active" in caplog.text and caplog.text.count("\n") == 1


def test_what_must_be_mended_is_refused_with_every_remedy(simulated, tmp_path):
    simulated.ask("install", payload_kg=0.0, remote=False)
    with pytest.raises(NotReady, match=r"payload: none entered.*remote control at the pendant") as caught:
        examination(tmp_path / "rec", 1, True, True)(RigDescription(), simulated.host, True)
    assert "local control" in str(caught.value) and "nothing has moved" in str(caught.value)


def test_a_session_for_a_hanging_arm_is_refused_on_a_standing_one(simulated, tmp_path):
    with pytest.raises(NotReady, match="mounting"):
        examination(tmp_path / "rec", -1, True, False)(RigDescription(), simulated.host, True)


@pytest.mark.parametrize("program", ["PLAYING", "PAUSED"])
def test_a_program_that_runs_is_reported_and_left_alone_unless_taken_over(simulated, program, tmp_path):
    simulated.ask("install", program=program)
    with pytest.raises(NotReady, match=f"left alone.*{program} palletizing.*--take-over"):
        with UniversalRobot(simulated.host, client="koala"):
            pass
    with pytest.raises(NotReady, match=f"program: {program} palletizing"):
        examination(tmp_path / "rec", 1, True, False)(RigDescription(), simulated.host, True)
    assert state(simulated.host) == f"{program} palletizing.urp"
    examination(tmp_path / "rec", 1, True, True)(RigDescription(), simulated.host, True)
    with UniversalRobot(simulated.host, client="koala", take_over=True) as robot:
        assert "palletizing" not in state(simulated.host)
        assert robot.description()["model"] == "UR5e"


def test_the_model_that_is_recorded_is_the_one_that_stands_there(simulated):
    simulated.ask("install", model="ur10e")
    with UniversalRobot(simulated.host, client="koala") as robot:
        assert robot.description()["model"] == "UR10e"


def test_the_commands(run_inside, simulated, tmp_path: Path):
    capture = partial(run_inside, main, "capture")
    rig, out, small = tmp_path / "rig.yaml", tmp_path / "rec", tmp_path / "small.yaml"
    small.write_text(SESSION)
    write_simulated_rig(rig, simulated, "shiny_ball", 3)
    simulated.ask("install", program="PLAYING", payload_kg=0.0)
    done = capture("doctor", "--rig", rig, "--seconds", 0.2)
    assert done.returncode == 1 and not done.stderr, done.stderr
    rows = {line[:17].strip(): line[17:].split()[0] for line in done.stdout.splitlines()}
    assert {name for name, verdict in rows.items() if verdict == "wrong"} == {"program", "payload"}, done.stdout
    refused = capture("run", small, "--rig", rig, "--out", out)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1) and "payload: none entered" in refused.stderr
    assert not out.exists() and state(simulated.host) == "PLAYING palletizing.urp"
    simulated.ask("install")
    good = capture("doctor", "--rig", rig, "--seconds", 0.2, "--json")
    assert good.returncode == 0 and {line["verdict"] for line in json.loads(good.stdout)["lines"]} == {"ok", "unknown"}


def test_a_line_that_is_ignored_is_shown_and_the_recording_keeps_it(run_inside, simulated, tmp_path: Path, caplog):
    capture = partial(run_inside, main, "capture")
    rig, out, small = tmp_path / "rig.yaml", tmp_path / "rec", tmp_path / "small.yaml"
    small.write_text(SESSION)
    write_simulated_rig(rig, simulated, "shiny_ball", 3)
    simulated.ask("install", payload_kg=0.0, up=[0.0, 0.2, 0.98])
    both = ["--ignore", "payload", "--ignore", "mounting"]
    done = capture("doctor", "--rig", rig, "--seconds", 0.2, *both)
    rows = {line[:17].strip(): line[17:].split()[0] for line in done.stdout.splitlines()}
    assert done.returncode == 0 and {name for name, verdict in rows.items() if verdict == "ignored"} == {"payload", "mounting"}
    refused = capture("run", small, "--rig", rig, "--out", out, "--ignore", "payload")
    assert refused.returncode == 1 and "mounting: " in refused.stderr and not out.exists()
    taken = capture("run", small, "--rig", rig, "--out", out, *both)
    assert taken.returncode == 0, taken.stderr
    assert "payload: none entered; ignored" in caplog.text
    kept = json.loads((out / "manifest.json").read_text())["ignored_checks"]
    assert kept.keys() == {"payload", "mounting"} and kept["payload"] == "none entered"
    assert capture("replay", out, "--rig", rig).returncode == 1
    assert capture("replay", out, "--rig", rig, *both).returncode == 0
    assert capture("run", small, "--rig", rig, "--dry-run").returncode == 1
    assert capture("run", small, "--rig", rig, "--dry-run", *both).returncode == 0


def test_an_unknown_line_cannot_be_ignored(run_inside, simulated, tmp_path: Path):
    capture = partial(run_inside, main, "capture")
    rig = tmp_path / "rig.yaml"
    write_simulated_rig(rig, simulated, "shiny_ball", 3)
    refused = capture("doctor", "--rig", rig, "--seconds", 0.2, "--ignore", "pay load")
    assert refused.returncode == 2 and "no line of 'capture doctor' is called 'pay load'" in refused.stderr
    assert "the lines are RTDE, primary interface," in refused.stderr and "speed slider" in refused.stderr


def test_a_resumed_session_adds_what_it_ignores(run_inside, simulated, tmp_path: Path):
    capture = partial(run_inside, main, "capture")
    rig, out, small = tmp_path / "rig.yaml", tmp_path / "rec", tmp_path / "small.yaml"
    small.write_text(SESSION)
    write_simulated_rig(rig, simulated, "shiny_ball", 3)
    assert capture("run", small, "--rig", rig, "--out", out).returncode == 0
    simulated.ask("install", payload_kg=0.0)
    assert capture("run", small, "--rig", rig, "--out", out, "--resume", "--ignore", "payload").returncode == 0
    assert json.loads((out / "manifest.json").read_text())["ignored_checks"] == {"payload": "none entered"}


def test_a_replay_begins_with_the_doctor_and_needs_the_recorded_arm(run_inside, simulated, tmp_path: Path):
    capture = partial(run_inside, main, "capture")
    rig, out, small = tmp_path / "rig.yaml", tmp_path / "rec", tmp_path / "small.yaml"
    small.write_text(SESSION)
    write_simulated_rig(rig, simulated, "shiny_ball", 3)
    assert capture("run", small, "--rig", rig, "--out", out).returncode == 0
    rests = simulated.ask("truth")["joints"]
    simulated.ask("install", payload_kg=0.0)
    refused = capture("replay", out, "--rig", rig)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1) and "payload: none entered" in refused.stderr
    simulated.ask("install")
    refused = capture("replay", out, "--rig", "sim:ur10e_gige")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1) and "recorded with another arm" in refused.stderr
    np.testing.assert_allclose(simulated.ask("truth")["joints"], rests, atol=1e-9)
    assert capture("replay", out, "--rig", rig).returncode == 0
