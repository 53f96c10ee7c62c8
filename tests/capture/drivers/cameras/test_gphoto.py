"""Through libgphoto2, on its virtual camera, in a process of its own: gphoto2 reads its environment when it is imported."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

from koala3d.capture.drivers.cameras.gphoto import VIRTUAL, microseconds

PROGRAM = """
import json, sys
from pathlib import Path
from koala3d.capture.model.device import Device
from koala3d.capture.drivers.cameras.gphoto import GphotoCamera
from koala3d.capture.doctor.camera import check
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.rig import CameraDescription
from koala3d.capture.model.trajectory import CameraSettings

pictures, found = Path(sys.argv[1]), {}
plain = {"model": "gphoto2", "leave": ["gain_db"], "settings": {"f-number": "f/8"}}
settings = CameraSettings(width=640, height=480, exposure_us=20_000)
with GphotoCamera(settings, Device(**plain), pictures=pictures) as camera:
    image = camera.grab()
    said = camera.description()
found["mean"], found["exposure_us"], found["said"] = image.pixels.reshape(-1, 3).mean(0).tolist(), image.exposure_us, said
found["left over"] = [path.name for path in pictures.rglob("*.JPG")]
for name, device, changes in json.loads(sys.argv[2]):
    try:
        with GphotoCamera(settings.model_copy(update=changes), Device(**{**plain, **device}), pictures=pictures):
            found[name] = "opened"
    except CaptureError as error:
        found[name] = str(error)
with GphotoCamera(settings, Device(**plain), pictures=pictures).inspected() as shown:
    lines = check(shown.nodes, shown.serial, {"firmware": "1"}, CameraDescription(**plain))
found["doctor"] = {line.name: [str(line.verdict), line.found] for line in lines}
print(json.dumps(found))
"""
WRONG = [
    ("no iso", {"leave": []}, {}, "takes no gain_db (it has no iso)"),
    ("another aperture", {"settings": {"f-number": "f/3"}}, {}, "rejected f-number (requested f/3, possible: f/2.8, f/3.5"),
    ("fixed", {"settings": {"batterylevel": "9"}}, {}, "batterylevel cannot be changed from here (it stays at 50%)"),
    ("serial", {"serial": "77"}, {}, "camera 77: no camera was found (connected: 0.1)"),
    ("time", {}, {"exposure_us": 4000.0}, "rejected shutterspeed (requested 4000, nearest: 0.0050s (5000)"),
    ("size", {}, {"width": 600}, "requested 600x480, actual 640x480; it offers 640x480, 1024x768, 2048x1536"),
]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    if find_spec("gphoto2") is None:
        pytest.skip("not installed: gphoto2")
    folder = tmp_path_factory.mktemp("camera")
    card = folder / "DCIM" / "100GPHOT"
    card.mkdir(parents=True)
    cv2.imwrite(str(card / "GPH_0001.JPG"), np.full((480, 640, 3), (30, 60, 120), np.uint8))  # blue, green, red
    asked = json.dumps([[name, device, changes] for name, device, changes, _ in WRONG])
    command = [sys.executable, "-P", "-c", PROGRAM, str(folder), asked]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_picture_is_taken_fetched_decoded_and_deleted_from_the_camera(found):
    np.testing.assert_allclose(found["mean"], [120, 60, 30], atol=3)  # JPEG's rounding
    assert found["exposure_us"] == 20_000
    assert found["left over"] == ["GPH_0001.JPG"], "what was on the card before stays"
    said = found["said"]
    assert (said["serial"], said["virtual"], said["state"]["f-number"], said["state"]["autofocus"]) == ("0.1", True, "f/8", "Off")


@pytest.mark.parametrize(("name", "words"), [(name, words) for name, _, _, words in WRONG])
def test_what_the_camera_cannot_do_is_said(found, name, words):
    assert words in found[name]


def test_the_doctor_asks_it(found):
    assert found["doctor"]["camera serial"] == ["unknown", "0.1"] and found["doctor"]["camera settings"] == ["ok", "f-number f/8"]
    assert "wrong" not in [verdict for verdict, _ in found["doctor"].values()]


@pytest.mark.parametrize(
    ("word", "us"),
    [
        ("1/125", 8000),
        ("0.0100s", 10_000),
        ("2", 2e6),
        ("10/25", 4e5),
        ("1/0", None),
        ("bulb", None),
        ("0", None),
        ("1/4 s", 250_000),
    ],
)
def test_exposure_times_are_read_in_every_makers_words(word, us):
    assert microseconds(word) == (None if us is None else pytest.approx(us))


def test_the_variable_is_that_of_the_package():
    if find_spec("gphoto2") is None:
        pytest.skip("not installed: gphoto2")
    with open(find_spec("gphoto2").origin) as file:  # read, not imported
        assert VIRTUAL in file.read()
