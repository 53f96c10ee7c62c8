"""What a rig file may say about its camera."""

from pathlib import Path

import pytest

from koala3d.capture.model.rig import load_rig
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.rig.cameras import driver_of
from koala3d.datasets.core.errors import UsageError


def rig(folder: Path, camera: str) -> Path:
    (folder / "rig.yaml").write_text(f"camera: {camera}\n")
    return folder / "rig.yaml"


@pytest.mark.parametrize(
    ("camera", "words"),
    [
        ("{model: basler, source: '0'}", "source means nothing to basler: remove it"),
        ("{model: opencv, depth: {width: 640}}", "depth means nothing to opencv"),
        ("{model: gphoto2, source: x, depth: {}}", "depth, source means nothing to gphoto2"),
        ("{model: opencv, leave: [exposure]}", "leave.*'exposure_us'"),
        ("{model: kinect}", "model.*'basler', 'genicam', 'opencv', 'realsense' or 'gphoto2'"),
        ("{model: realsense, settings: {gain: [1]}}", "settings.gain"),
    ],
)
def test_what_a_driver_would_ignore_is_refused(tmp_path, camera, words):
    with pytest.raises(UsageError, match=words):
        load_rig(rig(tmp_path, camera))


def test_files_of_a_source_lie_beside_the_rig_file(tmp_path):
    (tmp_path / "shots").mkdir()
    found = load_rig(rig(tmp_path, "{model: opencv, source: 'shots/%03d.png'}"))
    assert found.camera.source == str(tmp_path / "shots" / "%03d.png")
    assert load_rig(rig(tmp_path, "{model: opencv, source: '1'}")).camera.source == "1"


@pytest.mark.parametrize("model", ["basler", "genicam", "opencv", "realsense", "gphoto2"])
def test_every_model_has_a_driver_that_connects_only_when_entered(tmp_path, model):
    camera = driver_of(load_rig(rig(tmp_path, f"{{model: {model}, serial: '7'}}")).camera, CameraSettings())
    assert {"__enter__", "__exit__", "grab", "set_exposure", "description"} <= set(dir(camera))
