import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from koala3d.capture.cli import main
from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.kinematics import forward
from koala3d.capture.model.rig import load_rig
from koala3d.capture.sim.controller.handle import ControllerHandle
from koala3d.capture.sim.laboratory.scenes import stage
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording

SESSION = """\
format: koala-trajectory
version: 1
name: three
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [40, 60], azimuth_deg: [150, 210], rings: 1,
     count: COUNT, roll_deg: [0, 90, 180, 270]}
split: {train: TRAIN, test: 1}
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 1, width: 48, height: 48}
"""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = tmp_path / "three.yaml"
    path.write_text(SESSION.replace("COUNT", "3").replace("TRAIN", "2"))
    return path


@pytest.fixture(scope="session")
def capture(run_inside):
    """Runs the command inside this process."""
    return partial(run_inside, main, "capture")


def test_records_a_session_and_refuses_to_overwrite_it(capture, session, tmp_path):
    done = capture("run", session, "--scene", "shiny_ball", "--out", tmp_path / "rec", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 3
    recording = Recording.open(tmp_path / "rec")
    assert [frame.split for frame in recording.frames].count("test") == 1 and recording.manifest["scene"] == "shiny_ball"
    poses = files.read_json(tmp_path / "rec" / "truth" / "poses.json")
    assert sorted(poses["base_from_camera"]) == [frame.name for frame in recording.frames]
    again = capture("run", session, "--out", tmp_path / "rec")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1) and "already exists" in again.stderr


def test_an_object_that_was_turned_over_is_another_session(capture, session, tmp_path):
    """The recording says so, and the simulation has turned it: what was on the table is seen from above."""
    done = capture("run", session, "--scene", "mug", "--pose", "under", "--out", tmp_path / "under")
    assert done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "under").pose == "under"
    surface = trimesh.load_mesh(tmp_path / "under" / "truth" / "object.ply")
    upright = stage("mug", centre=(0.4, 0, 0.1), size=(0.2, 0.2, 0.2), seed=0).mesh()
    assert surface.volume == pytest.approx(upright.volume, rel=1e-3)
    assert surface.bounds[0, 2] == pytest.approx(0, abs=1e-6) and not np.allclose(surface.bounds, upright.bounds, atol=5e-3)
    done = capture("run", session, "--scene", "mug", "--out", tmp_path / "under", "--resume")
    assert done.returncode == 2 and "was taken with another pose" in done.stderr


HANGING = """\
format: koala-trajectory
version: 1
name: hanging
up: -z
views:
  - {kind: orbit, target: [0.0, 0.0, 1.1], distance: 1.0, elevation_deg: 40, azimuth_deg: [60, 240], count: 2,
     roll_deg: [0, 90, 180, 270]}
split: {train: 1, test: 1}
safety: {table_z: 1.2, ceiling_z: 0.0}
object: {centre: [0.0, 0.0, 1.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 4, width: 64, height: 64}
"""


def test_an_arm_that_hangs_records_a_session(capture, tmp_path):
    path, out = tmp_path / "hanging.yaml", tmp_path / "rec"
    path.write_text(HANGING)
    done = capture("run", path, "--scene", "shiny_ball", "--out", out)
    assert done.returncode == 0, done.stderr
    (seen,) = (out / "truth" / "alpha").iterdir()
    rows, columns = np.nonzero(images.read(seen)[..., 0] > 0.5)
    width = 2 * 0.1 * 1273 / 4  # of the ball, at 1 m
    # the ball is as wide as the picture, of which the mount, off by a degree, cuts up to 6 pixels
    assert np.ptp(columns) == pytest.approx(width, abs=6) and (rows.mean(), columns.mean()) == pytest.approx((32, 32), abs=8)
    surface = trimesh.load_mesh(out / "truth" / "object.ply")
    np.testing.assert_allclose(surface.bounds, [[-0.1, -0.1, 1.0], [0.1, 0.1, 1.2]], atol=1e-3)  # on the table below the base


def test_sim_starts_as_a_hanging_arm(tmp_path):
    rig, host = tmp_path / "rig.yaml", f"127.78.{os.getpid() % 200 + 1}.1"
    command = [sys.executable, "-m", "koala3d.capture.cli", "sim", "--hangs", "--out", str(rig), "--host", host]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None and host in process.stdout.readline()
        simulation = load_rig(rig).simulation
        assert simulation is not None
        with closing(ControllerHandle(host, simulation.side_port)) as controller:
            place = controller.true_base_from_flange()
        process.kill()
    np.testing.assert_allclose(place[:3, 3], forward(load_arm("ur5e").hanging_home)[:3, 3], atol=5e-3)  # links as built


def test_ctrl_c_keeps_the_frames_and_says_how_to_resume(capture, tmp_path):
    path = tmp_path / "many.yaml"
    path.write_text(SESSION.replace("COUNT", "12").replace("TRAIN", "11"))
    out = tmp_path / "rec"
    command = [sys.executable, "-m", "koala3d.capture.cli", "run", str(path), "--scene", "grey_card", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 90
    while not (out / "frames.jsonl").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group
    words = process.communicate(timeout=60)[1]
    assert process.returncode == 1 and words.count("error:") == 1 and "--resume" in words, words
    before = len(Recording.open(out).frames)
    assert 1 <= before < 12
    done = capture("run", path, "--scene", "grey_card", "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    names = [frame.name for frame in Recording.open(out).frames]
    assert len(names) == len(set(names)) == 12


@pytest.mark.parametrize(
    ("change", "arguments", "words"),
    [
        (("binning", "binnning"), [], "line 9: unknown key 'camera.binnning'; did you mean 'binning'?"),
        (("", ""), ["--scene", "gold_hed"], "unknown scene 'gold_hed'; did you mean 'gold_head'?"),
        (("", ""), ["--scene", "board"], "needs a trajectory with 'target'"),
        (("", ""), ["--rig", "nowhere.yaml"], "nowhere.yaml: no such file; --rig takes sim, a name"),
        (("distance: 0.4", "distance: 2.0"), [], "views cannot be taken"),
        (("width: 48", "width: wide"), [], "camera.width"),
    ],
)
def test_a_usage_error_is_one_line_and_leaves_nothing(capture, session, tmp_path, change, arguments, words):
    session.write_text(session.read_text().replace(*change))
    done = capture("run", session, "--out", tmp_path / "rec", *arguments)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and words in done.stderr, done.stderr
    assert not (tmp_path / "rec").exists()


def test_a_camera_that_rejects_a_setting_leaves_nothing(capture, session, tmp_path):
    session.write_text(session.read_text().replace("binning: 1", "binning: 5"))
    done = capture("run", session, "--scene", "shiny_ball", "--out", tmp_path / "rec")
    assert done.returncode == 1 and "BinningHorizontal (requested 5" in done.stderr
    assert not (tmp_path / "rec").exists()


def test_a_missing_camera_is_one_line_and_leaves_nothing(capture, session, tmp_path):
    (tmp_path / "real.yaml").write_text("robot: {installation: {payload_kg: 0.6}}")
    done = capture("run", session, "--rig", tmp_path / "real.yaml", "--out", tmp_path / "rec")
    if "cannot be reached" in done.stderr or "several" in done.stderr:
        pytest.skip("a Basler camera is connected to this computer")
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert "nothing has moved" in done.stderr and "no Basler camera was found (connected: none)" in done.stderr
    assert not (tmp_path / "rec").exists()


def test_plan_checks_every_view(capture, session):
    done = capture("plan", session, "--json")
    assert done.returncode == 0
    content = json.loads(done.stdout)
    assert content["splits"] == {"train": 2, "test": 1} and 1 < content["seconds"] < 60


def test_plan_writes_its_drawings(capture, session, tmp_path):
    done = capture(
        "plan", session, "--plot", tmp_path / "plan.png", "--page", tmp_path / "plan.html", "--set", "motion.speed=0.5"
    )
    assert done.returncode == 0 and "drawn in" in done.stdout, done.stderr
    assert (tmp_path / "plan.png").stat().st_size > 10_000 and "three" in (tmp_path / "plan.html").read_text()
    again = capture("plan", session, "--plot", tmp_path / "plan.png")
    assert again.returncode == 2 and "already exists" in again.stderr


@pytest.fixture
def running_sim(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """`capture sim` by itself, and the rig file that it has written."""
    rig = tmp_path / "rig.yaml"
    host = f"127.77.{os.getpid() % 200 + 1}.1"
    options = {"--scene": "board", "--out": str(rig), "--host": host, "--time-scale": "20", "--seed": "3"}
    command = [sys.executable, "-m", "koala3d.capture.cli", "sim", *(word for option in options.items() for word in option)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert f"UR5e at {host}: rtde 30004, script 30003, dashboard 29999" in line
        yield process, rig
        process.kill()


def test_sim_serves_a_session_and_ends_with_ctrl_c(capture, running_sim, tmp_path):
    from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard

    process, rig = running_sim
    board = "calibration_demo"
    small = [word for change in ("views.0.count=8", "camera.width=120", "camera.height=80") for word in ("--set", change)]
    done = capture("run", board, "--rig", rig, "--out", tmp_path / "rec", *small, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) | {"seconds": 0} == {
        "recording": str(tmp_path / "rec"),
        "frames": 8,
        "seconds": 0,
        "scene": "board",
        "cameras": [],
    }
    assert Recording.open(tmp_path / "rec").manifest["seed"] == 3
    host = Recording.open(tmp_path / "rec").manifest["robot"]["host"]
    second = capture("sim", "--host", host)
    assert second.returncode == 1 and "not free" in second.stderr and second.stderr.count("\n") == 1
    Dashboard.connect(host).close()
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(10) == 0 and process.stderr.read() == ""
    with pytest.raises(RigConnectionError):
        Dashboard.connect(host)

    checked = capture("check", tmp_path / "rec", "--json")
    assert (checked.returncode, json.loads(checked.stdout)["findings"]) == (0, []), checked.stdout
    replayed = capture("replay", tmp_path / "rec", "--out", tmp_path / "replay.json")
    assert replayed.returncode == 0 and replayed.stdout.count("\n") == 9, replayed.stderr
    content = files.read_json(tmp_path / "replay.json", kind="koala-replay", version=1)
    assert content["translation_mm"]["worst"] < 0.07  # to where it says that it was: noise of encoders, see test_kill
    assert 0.02 < content["true_mm"]["rms"] < 0.15  # twice 0.03 mm along three axes: 0.073

    (tmp_path / "rec" / "images" / "004.png").write_bytes(b"")
    bad = capture("check", tmp_path / "rec")
    assert bad.returncode == 1 and "view 004: its image has changed" in bad.stdout and "retake: 004" in bad.stdout
    assert capture("check", tmp_path / "rec", "--discard").returncode == 1
    again = capture("run", board, "--rig", "sim", "--seed", 3, "--out", tmp_path / "rec", "--resume", *small)
    assert again.returncode == 0, again.stderr  # the same rig, wherever its controller is
    assert capture("check", tmp_path / "rec").returncode == 0


def test_list_names_what_is_installed_and_what_it_is(capture):
    done = capture("list")
    assert done.returncode == 0, done.stderr
    for line in ("trajectories:", "rigs:", "scenes:", "  koala_demo ", "  ur5e_basler ", "  gold_head "):
        assert line in done.stdout
    content = json.loads(capture("list", "--json").stdout)
    assert content["trajectories"]["koala_demo"].startswith("Demo: 50 small pictures") and "sim" not in content["rigs"]


def test_a_shipped_trajectory_is_planned_by_name_from_any_folder(capture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = capture("plan", "calibration_demo", "--rig", "ur5e_basler", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["views"] == 25
    wrong = capture("plan", "calibration_dmo")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1) and "did you mean 'calibration_demo'?" in wrong.stderr
    wrong = capture("view", "calibration_dmo", "--port", "0")
    assert wrong.returncode == 2 and "there is no trajectory 'calibration_dmo'" in wrong.stderr
