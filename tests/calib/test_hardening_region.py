"""A calibration file says itself which region of the sensor it is for."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.sessions.session import observe_recording
from koala3d.datasets.building.build import camera_for
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.recording import Recording

REGION = {"width": 480, "height": 300, "offset_x": 40, "offset_y": 20, "binning": 1}


@pytest.fixture(scope="module")
def made(recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded target session, whose camera read out a part of its sensor, and its calibration."""
    folder = tmp_path_factory.mktemp("region")
    path = folder / "session"
    shutil.copytree(recorded[0], path)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps({**manifest, "camera": {"region": REGION}}))
    calibrate_handeye(observe_recording(path)).save(folder / "calibration.json")
    return folder


@pytest.fixture
def session(made: Path) -> Iterator[Path]:
    """The recording. Where a test has moved it, it is put back."""
    yield made / "session"
    if (made / "moved").exists():
        (made / "moved").rename(made / "session")


@pytest.fixture
def calibration(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made / "calibration.json", tmp_path))


@pytest.fixture
def other_region(session: Path, tmp_path: Path) -> Recording:
    """A recording by the same camera with its region 8 px further to the right."""
    path = tmp_path / "recording"
    shutil.copytree(session, path)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_text(json.dumps({**manifest, "camera": {"region": {**REGION, "offset_x": 48}}}))
    return Recording.open(path)


def test_the_premise_the_region_moves_the_principal_point(calibration: Path, other_region: Recording) -> None:
    known = Calibration.load(calibration)
    camera, notes = camera_for(other_region, known)
    assert camera.cx == pytest.approx(known.camera.cx - 8) and "converted" in notes[0]


def test_the_region_outlives_the_recording(calibration: Path, session: Path, other_region: Recording) -> None:
    before = Calibration.load(calibration).camera.cx
    session.rename(session.with_name("moved"))
    camera, _ = camera_for(other_region, Calibration.load(calibration))
    assert camera.cx == pytest.approx(before - 8)


def test_an_older_file_without_a_region_is_said_to_be_so(calibration: Path, session: Path, other_region: Recording) -> None:
    content = json.loads(calibration.read_text())
    content.pop("region", None)
    content["provenance"].pop("region", None)
    calibration.write_text(json.dumps(content))
    session.rename(session.with_name("moved"))
    _, notes = camera_for(other_region, Calibration.load(calibration))
    assert any("region" in note for note in notes)
