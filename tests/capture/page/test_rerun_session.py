"""A recorded session in a file of Rerun, read back by Rerun: the arm, its flange, the camera and the pictures at each view."""

from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from koala3d.capture.cli import main
from koala3d.capture.cli.run import _shown_in_rerun
from koala3d.capture.model.rig import recorded_carrier
from koala3d.datasets.core import files
from koala3d.datasets.recording import Recording
from tests import rrd

SESSION = """\
format: koala-trajectory
version: 1
name: three
views:
  - {kind: hemisphere, target: [0.4, 0.0, 0.1], distance: 0.4, elevation_deg: [40, 60], azimuth_deg: [150, 210], rings: 1,
     count: 3, roll_deg: [0, 90, 180, 270]}
split: {train: 2, test: 1}
object: {centre: [0.4, 0.0, 0.1], size: [0.2, 0.2, 0.2]}
camera: {exposure_us: 10000, binning: 1, width: 48, height: 32}
"""


@pytest.fixture(scope="module")
def recorded(run_inside, tmp_path_factory) -> tuple[Path, Path]:
    """A recording, and the file that was written with it."""
    pytest.importorskip("rerun", reason="rerun-sdk is absent: pip install 'koala-capture[rerun]'")
    folder = tmp_path_factory.mktemp("session")
    files.write_text(folder / "three.yaml", SESSION)
    words = ("run", folder / "three.yaml", "--scene", "shiny_ball", "--out", folder / "rec", "--rerun", folder / "s.rrd")
    done = partial(run_inside, main, "capture")(*words)
    assert done.returncode == 0, done.stderr
    return folder / "rec", folder / "s.rrd"


def test_flange_camera_and_picture_of_each_view(recorded: tuple[Path, Path]) -> None:
    recording, found = Recording.open(recorded[0]), rrd.read(recorded[1], "view")
    carrier = recorded_carrier(recording)
    frames = sorted(recording.frames, key=lambda frame: frame.robot_time_s)
    for entity, pose_of in (("flange", lambda matrix: matrix), ("camera", carrier.camera_at)):
        places = found[f"/base/{entity} Transform3D:translation"]
        assert [when for when, _ in places] == [0, 1, 2]
        for frame, (_, place) in zip(frames, places, strict=True):
            assert np.allclose(place[0], pose_of(frame.base_from_flange)[:3, 3], atol=1e-6)  # Rerun stores float32
    pictures = found["/base/camera/picture EncodedImage:blob"]
    files_of = [cv2.imread(str(recording.image_path(frame))).astype(float) for frame in frames]
    assert np.abs(files_of[0] - files_of[1]).mean() > 16, "views differ"
    for frame, (_, stored) in zip(frames, pictures, strict=True):
        shown = cv2.imdecode(np.array(stored[0], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        taken = cv2.imread(str(recording.image_path(frame)))[..., ::-1]
        assert shown.shape == taken.shape == (32, 48, 3)
        assert (
            np.abs(shown.astype(float) - taken).mean() < 8
        )  # of 255: JPEG at a quality of 85, of a picture that is mostly noise
    assert [values[0] for _, values in found["/measured/exposure_us Scalars:scalars"]] == [frame.exposure_us for frame in frames]


def test_the_arms_capsules_lie_between_its_joints(recorded: tuple[Path, Path]) -> None:
    recording, found = Recording.open(recorded[0]), rrd.read(recorded[1], "view")
    carrier = recorded_carrier(recording)
    frames = sorted(recording.frames, key=lambda frame: frame.robot_time_s)
    names = {key.split()[0] for key in found if key.startswith("/base/arm/") and "Capsules3D:lengths" in key}
    segments = carrier.segments(frames[1].joints)
    assert len(names) == len(segments) > 6
    drawn = []
    for name in names:
        length = found[f"{name} Capsules3D:lengths"][0][1][0]
        start = np.array(found[f"{name} Transform3D:translation"][1][1][0])
        turn = np.reshape(found[f"{name} Transform3D:mat3x3"][1][1][0], (3, 3)).T
        drawn.append([start, start + length * turn[:, 2]])
    for segment in segments:
        assert min(np.abs(np.array(one) - segment).max() for one in drawn) < 1e-5


def test_the_clock_is_the_arms(recorded: tuple[Path, Path]) -> None:
    recording, found = Recording.open(recorded[0]), rrd.read(recorded[1], "time")
    times = [when.total_seconds() for when, _ in found["/base/flange Transform3D:translation"]]
    stamps = sorted(frame.robot_time_s for frame in recording.frames)
    assert np.allclose(times, np.array(stamps) - stamps[0], atol=1e-6)


def test_a_dry_run_writes_none(run_inside, tmp_path: Path) -> None:
    files.write_text(tmp_path / "three.yaml", SESSION)
    done = run_inside(main, "capture", "run", tmp_path / "three.yaml", "--dry-run", "--rerun", tmp_path / "s.rrd")
    assert done.returncode == 2 and "--rerun" in done.stderr and not (tmp_path / "s.rrd").exists()


def test_a_session_that_was_stopped_is_written_too(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), _shown_in_rerun(tmp_path / "s.rrd", recorded[0], "sim"):
        raise KeyboardInterrupt
    assert len(rrd.read(tmp_path / "s.rrd", "view")["/base/camera/picture EncodedImage:blob"]) == 3
