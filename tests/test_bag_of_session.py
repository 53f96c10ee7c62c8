"""A session over RTDE as a ROS bag: the calibration of the session itself, and the latency that was put into the time stamps.

`capture run` drives the simulated controller. Meanwhile a witness, another client of the same controller, keeps what the arm
reports all the time, as drivers publish it on /tf, and where the arm truly is during exposures on its way. What a camera sees
then is drawn afterwards, by the session's own simulated camera.
"""

import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.sessions.session import observe_recording
from koala3d.capture.cli import main
from koala3d.capture.drivers.ur.rtde.stream import RtdeStream
from koala3d.capture.model.kinematics import pose_from_six
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.rig.controllers import write_simulated_rig
from koala3d.capture.sim.camera import MOMENTS, SimulatedCamera
from koala3d.capture.sim.controller.handle import ControllerHandle
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.capture.sim.truth import RigTruth
from koala3d.datasets.bags.recorded import recording_of
from koala3d.datasets.core import files
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Recording
from tests import bags

VIEWS, SEED, TIME_SCALE, LATE_S = 10, 3, 4.0, 0.020
EXPOSURE_S, EVERY_S, SAMPLES_HZ = 0.004, 0.25, 250.0
"""Exposures on the way, the time from one to the next on the controller's clock, and how often the arm is asked in real time."""
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
Poses = NDArray[np.float64]


@dataclass
class Witness:
    """What the arm reported, and where it was; by the controller's clock [s]."""

    reported: list[tuple[float, Poses]] = field(default_factory=list)
    """(4, 4) base_from_flange."""
    exposed: list[tuple[float, Poses]] = field(default_factory=list)
    """The middle of an exposure, and (moments, 4, 4) true base_from_flange during it."""


class Passing:
    """An arm that passes the exposures of a witness, one with each picture of a simulated camera."""

    def __init__(self, witness: Witness) -> None:
        self._ahead = iter(witness.exposed)

    def exposed(self, exposure_s: float, count: int) -> Poses:
        return next(self._ahead)[1]


@contextmanager
def witnessing(controller: SimulatedController) -> Iterator[Witness]:
    """Listen to a controller from another thread."""
    found, ended = Witness(), threading.Event()

    def listen() -> None:
        stream = RtdeStream(controller.host, ["timestamp", "actual_TCP_pose"], [], SAMPLES_HZ)
        with closing(stream), closing(ControllerHandle(controller.host, controller.side_port)) as side:
            while not ended.wait(0.5 / SAMPLES_HZ) and stream.connected:
                if (sample := stream.newest()) is None:
                    continue
                found.reported.append((sample["timestamp"], pose_from_six(np.array(sample["actual_TCP_pose"]))))
                if not found.exposed or sample["timestamp"] > found.exposed[-1][0] + EVERY_S:
                    truth = side.ask("truth", exposure_s=EXPOSURE_S, count=MOMENTS)
                    if truth["moving"]:
                        found.exposed.append((truth["robot_time_s"] + EXPOSURE_S / 2, np.array(truth["exposed"])))

    thread = threading.Thread(target=listen, daemon=True)
    thread.start()
    try:
        yield found
    finally:
        ended.set()
        thread.join()


def on_the_way(trajectory: Path, witness: Witness) -> list[tuple[float, np.ndarray]]:
    """When the witness's exposures were, and what the session's camera sees then."""
    rig, session = RigDescription(), load_trajectory(trajectory)
    truth = RigTruth.of(rig.carrier(), session, SEED)
    with SimulatedCamera(session, "board", truth, Passing(witness), SEED, device=rig.camera) as camera:
        pictures = []
        for number, (when, _) in enumerate(witness.exposed, VIEWS):
            camera.prepare(number)
            pictures.append((when, camera.grab().pixels))
    return pictures


@pytest.fixture(scope="module")
def recorded(run_inside, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The session, and the bag of what its witness saw, in which the stamps of all pictures are late."""
    home = tmp_path_factory.mktemp("witnessed")
    trajectory, rig, out = home / "board.yaml", home / "rig.yaml", home / "recording"
    files.write_text(trajectory, BOARD)
    # without noise of the encoders: in the bag a view has another sample of it than in the session
    with SimulatedController.as_built(seed=SEED, time_scale=TIME_SCALE, noise_rad=0.0) as controller:
        write_simulated_rig(rig, controller, "board", SEED)
        with witnessing(controller) as witness:
            done = run_inside(main, "capture", "run", trajectory, "--rig", rig, "--out", out)
    assert done.returncode == 0, done.stderr
    recording = Recording.open(out)
    still = [(frame.robot_time_s, images.read_stored(recording.image_path(frame))) for frame in recording.frames]
    pictures = [*still, *on_the_way(trajectory, witness)]
    messages = [(when, "tf", place) for when, place in witness.reported]
    messages += [(when + LATE_S, "picture", picture) for when, picture in pictures]
    with bags.writing(home / "bag", "mcap") as bag:
        for when, what, content in sorted(messages, key=lambda one: one[0]):
            stamp = bags.START_NS + round(1e9 * when)
            if what == "tf":
                bag.transform("/tf", stamp, "base", "tool0", content)
            else:
                bag.picture("/camera/image_raw", stamp, content, "rgb8")
    return out, home / "bag"


@pytest.mark.timeout(600)
def test_a_bag_of_a_session_gives_its_calibration_and_the_latency(recorded: tuple[Path, Path], tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("KOALA_CACHE", str(tmp_path / "cache"))
    session, bag = recorded
    client = "ur_rtde" if find_spec("rtde_control") else "koala"
    assert Recording.open(session).part("robot")["client"].startswith(client)  # the premise: over loopback
    observed = observe_recording(session)
    wanted = calibrate_handeye(observed)
    found = calibrate_handeye(observe_recording(recording_of(bag), observed.board))
    late = found.residuals
    print(bags.apart(found, wanted), late, wanted.residuals)
    assert late.views_used == wanted.residuals.views_used == VIEWS
    assert bags.apart(found, wanted) < 0.1
    assert late.latency_pictures >= 10 and late.latency_std_s < 0.001
    assert late.latency_s == pytest.approx(LATE_S, abs=min(0.002, 4 * late.latency_std_s))
