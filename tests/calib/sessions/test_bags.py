"""A hand-eye session in a ROS bag gives what the session itself gives, and how late the pictures are."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from koala3d.calib import cli
from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.sessions.session import observe_recording
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.datasets import pose
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording
from tests import bags

REST_S, MOVE_S, LATE_S = 1.0, 1.0, 0.020


def in_motion(session, photograph, board, base_from_board, camera, seconds, seed=0):
    """(n,) pictures of a moving arm at times of its way, exposed for 4 ms."""
    rng = np.random.default_rng(seed)
    flanges = session.taken @ pose.inverse(session.flange_from_camera)
    found = []
    for moment in seconds:
        exposed = bags.at(flanges, moment + np.array([-0.002, 0.0, 0.002]), REST_S, MOVE_S) @ session.flange_from_camera
        grey = np.mean([photograph(board, camera, pose.inverse(one) @ base_from_board, rng=rng, samples=2) for one in exposed], 0)
        found.append(np.rint(255 * grey).astype(np.uint8))
    return found


@pytest.fixture(scope="module")
def halting(tmp_path_factory, make_recording, photograph):
    """(recording, kind to bag) of the session of 12 views, with pictures of the motion between them that are 20 ms late."""
    home = tmp_path_factory.mktemp("bags")
    session = make_recording(home / "recording", seed=5)
    recording = Recording.open(home / "recording")
    board, base_from_board = session.board, session.base_from_board
    camera = session.camera
    moments = np.concatenate([k * (REST_S + MOVE_S) + REST_S + MOVE_S * np.arange(0.15, 0.9, 0.15) for k in range(11)])
    moving = in_motion(session, photograph, board, base_from_board, camera, moments)
    still = {}
    for k, frame in enumerate(recording.frames):
        picture = np.rint(255 * images.read(recording.image_path(frame))).astype(np.uint8)
        still |= {k * (REST_S + MOVE_S) + offset: picture for offset in (0.3, 0.5, 0.7)}
    pictures = sorted(
        [*still.items(), *((m, np.repeat(p[..., None], 3, -1)) for m, p in zip(moments, moving, strict=True))], key=lambda x: x[0]
    )
    times, poses = bags.way(session.reported, REST_S, MOVE_S, 125)

    def write(kind: str) -> Path:
        path = home / {"ros1": "session.bag"}.get(kind, kind)
        if path.exists():
            return path
        with bags.writing(path, kind) as bag:
            messages = [(t, "tf", p) for t, p in zip(times, poses, strict=True)] + [(t, "picture", p) for t, p in pictures]
            for t, what, content in sorted(messages, key=lambda one: one[0]):
                stamp = bags.START_NS + round(1e9 * t)
                if what == "tf":
                    bag.transform("/tf", stamp, "base_link", "tool0", content)
                else:
                    bag.picture("/camera/image_raw", stamp + round(1e9 * LATE_S), content, "rgb8")
                    bag.camera_info("/camera/camera_info", stamp + round(1e9 * LATE_S), camera)
        return path

    return home / "recording", write, session


@pytest.mark.parametrize("kind", bags.KINDS)
def test_a_bag_gives_the_calibration_of_its_session_and_the_latency(halting, kind, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    recording, write, session = halting
    wanted = calibrate_handeye(observe_recording(recording))
    found = calibrate_handeye(observe_recording(recording_of(write(kind)), session.board))
    assert found.residuals.views_used == wanted.residuals.views_used == 12
    assert bags.apart(found, wanted) < 0.1
    late = found.residuals
    assert late.latency_s == pytest.approx(LATE_S, abs=min(0.002, 4 * late.latency_std_s))
    assert late.latency_std_s < 0.001 and late.latency_pictures >= 20


def wandering(count: int, seconds: float, session) -> tuple[np.ndarray, np.ndarray]:
    """(count,) times and true base_from_camera of a way above the board that never halts."""
    times = np.linspace(0, seconds, count)
    centre = (session.base_from_board @ [*session.board.points.mean(0)[:2], 0, 1])[:3]
    found = []
    for t in times:
        tilt = [0.5 * np.sin(1.1 * t), 0.45 * np.sin(0.8 * t + 1), 0.5 * np.sin(0.6 * t)]
        camera = pose.from_rotation_vector([np.pi, 0, 0]) @ pose.from_rotation_vector(tilt)
        camera[:3, 3] = (
            centre - camera[:3, 2] * (0.45 + 0.08 * np.sin(0.9 * t)) + 0.02 * np.array([np.sin(t), np.cos(1.3 * t), 0])
        )
        found.append(camera)
    return times, np.stack(found)


def test_an_arm_that_never_halts_is_calibrated_with_its_latency(small, photograph, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    rng, camera, late_s = np.random.default_rng(4), small.camera.scaled(480, 300), -0.035
    times, taken = wandering(6000, 24.0, small)
    flanges = taken @ pose.inverse(small.flange_from_camera)
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        for k in range(0, len(times), 2):  # 125 Hz
            noise = pose.from_rotation_vector(rng.normal(0, np.deg2rad(0.005), 3), rng.normal(0, 3e-5, 3))
            bag.transform("/tf", bags.START_NS + round(1e9 * times[k]), "base", "flange", flanges[k] @ noise)
        for k in range(20, len(times) - 20, 100):  # 2.5 Hz
            grey = photograph(small.board, camera, pose.inverse(taken[k]) @ small.base_from_board, rng=rng, samples=2)
            stamp = bags.START_NS + round(1e9 * (times[k] + late_s))
            bag.picture("/image", stamp, np.rint(255 * grey).astype(np.uint8), "mono8")
    session = observe_recording(recording_of(tmp_path / "bag"), small.board)
    assert session.clocked is not None and not session.clocked.halts
    found = calibrate_handeye(session)
    assert found.residuals.views_used >= 50
    late = found.residuals
    assert late.latency_s == pytest.approx(late_s, abs=min(0.002, 4 * late.latency_std_s)) and late.latency_std_s < 5e-4
    shift, turn = pose.difference(found.flange_from_camera.matrix, small.flange_from_camera)
    shift_mm, turn_deg = found.flange_from_camera.total_std
    assert 1e3 * shift < 3 * shift_mm < 0.3 and np.rad2deg(turn) < 3 * turn_deg < 0.1


def test_the_commands_take_bags(halting, tmp_path, monkeypatch, run_inside) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    _, write, session = halting
    bag, board, out = write("ros1"), tmp_path / "board.yaml", tmp_path / "calibration.json"
    failed = run_inside(cli.main, "calib", "handeye", bag, "--out", out)
    assert failed.returncode and "does not say which target it shows" in failed.stderr and "--board" in failed.stderr
    files.write_text(board, json.dumps(session.board.to_json()))
    done = run_inside(cli.main, "calib", "handeye", bag, "--board", board, "--out", out)
    assert done.returncode == 0, done.stderr
    off = re.search(
        r"note: camera_info in the bag is off from this camera by (0\.\d\d) px rms, (\d\.\d\d) px at most\n", done.stdout
    )
    assert off is not None and float(off[1]) < 0.5, "the bag's camera_info is the true camera"
    assert re.search(r"latency +(19|20)\.\d\d ± 0\.\d\d ms by \d+ pictures of a moving arm", done.stdout)
    assert Calibration.load(out).provenance["recording"] == str(bag)
    verified = run_inside(cli.main, "calib", "verify", bag, "--calibration", out, "--json")
    assert verified.returncode == 0 and json.loads(verified.stdout)["rms_px"] < 0.5
    assert run_inside(cli.main, "calib", "report", out, "--out", tmp_path / "page.html").returncode == 0
    alone = tmp_path / "camera.json"
    assert run_inside(cli.main, "calib", "intrinsics", bag, "--board", board, "--out", alone).returncode == 0
    assert Calibration.load(alone).camera.fx == pytest.approx(session.camera.fx, abs=4 * Calibration.load(alone).camera_std["fx"])
    words = ("plan", bag, "--board", board, "--intrinsics", alone, "--count", 1, "--out", tmp_path / "next.yaml", "--json")
    planned = run_inside(cli.main, "calib", *words)
    assert planned.returncode == 0, planned.stderr
    before, after = (json.loads(planned.stdout)[key] for key in ("before", "after"))
    assert after[0][0] < before[0] and load_trajectory(tmp_path / "next.yaml").number == 1
