"""A session over RTDE as a ROS bag: the calibration of the session itself, and the latency that was put into the time stamps.

`capture run` drives the simulated controller. In the bag the arm rests at the poses that it reported, and moves in between. What
the camera sees on the way is drawn by the simulation that made the session.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.sessions.session import observe_recording
from koala3d.capture.cli import main
from koala3d.capture.model.trajectory import recorded_trajectory
from koala3d.capture.sim.laboratory.lens import Lens, Sensor
from koala3d.capture.sim.laboratory.views import make_view
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording
from tests import bags

VIEWS, REST_S, MOVE_S, LATE_S, EXPOSURE_S = 10, 1.0, 3.0, 0.020, 0.004
BOARD = f"""\
format: koala-trajectory
version: 1
name: board
views:
  - {{kind: tilted, target: [0.40, 0.0, 0.0], distance: [0.30, 0.46], tilt_deg: [5, 40], turn_deg: [-180, 180],
     shift: [0.08, 0.06], roll_deg: [0, 90, 180, 270], count: {VIEWS}}}
target: {{kind: charuco, squares_x: 9, squares_y: 7, square_length_m: 0.03, marker_length_m: 0.022, dictionary: DICT_5X5_100}}
board: {{position: [0.265, 0.105, 0.003], rotation_deg: [180, 0, 0]}}
camera: {{exposure_us: {1e6 * EXPOSURE_S:g}, gain_db: 8, binning: 4, width: 480, height: 270}}
"""


@pytest.fixture(scope="module")
def session(run_inside, tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("session")
    files.write_text(home / "board.yaml", BOARD)
    done = run_inside(main, "capture", "run", home / "board.yaml", "--scene", "board", "--out", home / "recording")
    assert done.returncode == 0, done.stderr
    return home / "recording"


def on_the_way(recording: Recording, flanges: np.ndarray, moments: np.ndarray) -> list[np.ndarray]:
    """What the session's true camera sees in the middle of exposures at these times [s]."""
    truth, trajectory = files.read_json(recording.path / "truth" / "poses.json"), recorded_trajectory(recording)
    lens, view = (
        Lens(Camera.from_json(truth["camera"], where="truth")),
        make_view("board", trajectory, recording.manifest["seed"]),
    )
    settings, found = trajectory.camera, []
    for number, moment in enumerate(moments):
        during = bags.at(flanges, moment + EXPOSURE_S * np.array([-1 / 3, 0, 1 / 3]), REST_S, MOVE_S)
        light = view.radiance(lens, during @ np.array(truth["flange_from_camera"]), number)
        taken = {"exposure_us": settings.exposure_us, "gain_db": settings.gain_db, "binning": settings.binning}
        found.append(Sensor().expose(light, rng=np.random.default_rng(number), **taken))
    return found


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_bag_of_a_session_gives_its_calibration_and_the_latency(session: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    recording, period_s = Recording.open(session), REST_S + MOVE_S
    client = "ur_rtde" if find_spec("rtde_control") else "koala"
    assert recording.part("robot")["client"].startswith(client)  # the premise: over loopback, by the vendor's client
    flanges = np.stack([frame.base_from_flange for frame in recording.frames])
    moments = np.concatenate([k * period_s + REST_S + MOVE_S * np.array([0.25, 0.5, 0.75]) for k in range(VIEWS - 1)])
    still = [(k * period_s + REST_S / 2, images.read_stored(recording.image_path(f))) for k, f in enumerate(recording.frames)]
    moving = zip(moments, on_the_way(recording, flanges, moments), strict=True)
    messages = [(t, "tf", one) for t, one in zip(*bags.way(flanges, REST_S, MOVE_S, 125), strict=True)]
    messages += [(t + LATE_S, "picture", picture) for t, picture in (*still, *moving)]
    with bags.writing(tmp_path / "bag", "mcap") as bag:
        for t, what, content in sorted(messages, key=lambda one: one[0]):
            stamp = bags.START_NS + round(1e9 * t)
            if what == "tf":
                bag.transform("/tf", stamp, "base", "tool0", content)
            else:
                bag.picture("/camera/image_raw", stamp, content, "rgb8")
    observed = observe_recording(session)
    wanted = calibrate_handeye(observed)
    found = calibrate_handeye(observe_recording(recording_of(tmp_path / "bag"), observed.board))
    late = found.residuals
    assert late.views_used == wanted.residuals.views_used >= VIEWS - 2  # views whose corners stand out are left out
    assert bags.apart(found, wanted) < 0.1
    assert late.latency_pictures >= 10 and late.latency_std_s < 0.001
    assert late.latency_s == pytest.approx(LATE_S, abs=min(0.002, 4 * late.latency_std_s))
