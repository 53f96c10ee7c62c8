"""A session on a simulated rig that runs already, so that something can go wrong with it in the middle."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from koala3d.capture import cli
from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard
from koala3d.capture.sim.controller.process import SimulatedController
from koala3d.datasets.core import files
from koala3d.datasets.recording import Recording
from tests.capture.moving import moves
from tests.moments import as_soon_as

COUNT = 6
TRAJECTORY = """\
format: koala-trajectory
version: 1
name: faults
views:
  - {kind: tilted, target: [0.40, 0.0, 0.0], distance: [0.30, 0.46], tilt_deg: [5, 40], count: COUNT, roll_deg: [0, 90, 180, 270]}
target: {kind: charuco, squares_x: 9, squares_y: 7, square_length_m: 0.03, marker_length_m: 0.022, dictionary: DICT_5X5_100}
board: {position: [0.265, 0.105, 0.003], rotation_deg: [180, 0, 0]}
motion: {settle_time_s: 0.5}
camera: {exposure_us: 10000, binning: 4, width: 64, height: 48}
"""
"""A board at 64 x 48 pixels, cheap to render. The arm settles for longer than it oscillates (`arm.QUIET_S`), so that images are
the same bit for bit however few states a busy computer receives."""
RIG = "robot: {host: HOST, client: CLIENT}\nsimulation: {side_port: PORT, scene: board, seed: 4}\n"


@dataclass
class Session:
    """One recording under way: the controller, and the command that a user types."""

    controller: SimulatedController
    trajectory: Path
    rig: Path
    out: Path
    capsys: pytest.CaptureFixture[str]
    monkeypatch: pytest.MonkeyPatch
    count: int
    happened: float = 0.0

    def capture(self, *, resume: bool = False) -> tuple[int, str]:
        """Exit code of `capture run`, and what it wrote on stderr."""
        arguments = [str(self.trajectory), "--rig", str(self.rig), "--out", str(self.out), *(["--resume"] * resume)]
        self.monkeypatch.setattr(sys, "argv", ["capture", "run", *arguments])
        with pytest.raises(SystemExit) as left:
            cli.main()
        return int(left.value.code or 0), self.capsys.readouterr().err

    def frames(self) -> int:
        path = self.out / "frames.jsonl"
        return path.read_bytes().count(b"\n") if path.exists() else 0

    def capture_until(self, fault: Callable[["Session"], None], *, after: int, resume: bool) -> tuple[int, str]:
        """`capture`, and `fault` in the middle of the first motion after the given number of frames."""

        def strike() -> None:
            fault(self)
            self.happened = time.monotonic()

        with as_soon_as(lambda: self.frames() >= after and moves(self.controller), strike, f"a motion after {after} frames"):
            return self.capture(resume=resume)

    def check_whole(self) -> None:
        """Every frame is there once, in order, with its own image, and nothing else."""
        recording = Recording.open(self.out)
        names = [f"{index:03d}" for index in range(self.count)]
        assert [frame.name for frame in recording.frames] == names
        for frame in recording.frames:
            assert frame.sha256 == files.sha256(recording.image_path(frame))
        assert sorted(files.read_json(self.out / "truth" / "poses.json")["base_from_camera"]) == names
        assert sorted(path.name for path in (self.out / "images").iterdir()) == [f"{name}.png" for name in names]
        assert self.frames() == self.count

    def at_the_pendant(self, *orders: str) -> None:
        """What a person does there, by commands of the dashboard."""
        dashboard = Dashboard.connect(self.controller.host)
        for order in orders:
            dashboard.ask(order)
        dashboard.close()


@pytest.fixture
def trajectory_of(tmp_path: Path) -> Callable[[int], Path]:
    """Writes a trajectory with the given number of views."""

    def write(count: int) -> Path:
        path = tmp_path / "faults.yaml"
        path.write_text(TRAJECTORY.replace("COUNT", str(count)))
        return path

    return write


@pytest.fixture
def session(
    tmp_path: Path,
    client: str,
    trajectory_of: Callable[[int], Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Session]:
    with SimulatedController.start(seed=4, time_scale=8.0) as controller:
        rig = tmp_path / "rig.yaml"
        described = {"HOST": controller.host, "CLIENT": client, "PORT": json.dumps(controller.side_port)}
        text = RIG
        for word, value in described.items():
            text = text.replace(word, value)
        rig.write_text(text)
        yield Session(controller, trajectory_of(COUNT), rig, tmp_path / "recording", capsys, monkeypatch, COUNT)
