"""The contract of the driver on a real camera.

KOALA_BASLER=any .venv/bin/python -m pytest tests/hardware/test_basler.py -m hardware    (or a serial number)
"""

import os
import time

import numpy as np
import pytest

from koala3d.capture.drivers.cameras.basler import Basler
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

pytestmark = pytest.mark.hardware
SETTINGS = CameraSettings(width=640, height=480, exposure_us=5000, gain_db=0)


@pytest.fixture
def serial():
    asked = os.environ.get("KOALA_BASLER")
    if not asked:
        pytest.skip("no camera: KOALA_BASLER, its serial number or 'any', is not set")
    return "" if asked == "any" else asked


@pytest.mark.parametrize("name", ["rgb8", "bayer8", "bayer12"])
def test_pictures_come_with_their_settings_and_their_time(serial, name):
    settings = SETTINGS.model_copy(update={"pixel_format": name})
    try:
        camera = Basler(settings, Device(serial=serial)).__enter__()
    except CaptureError as error:
        if "does not send" in str(error):
            pytest.skip(str(error))
        raise
    with camera:
        images = [camera.grab() for _ in range(5)]
        state = camera.description()["state"]
    assert all(image.pixels.shape == (480, 640, 3) for image in images)
    assert images[0].pixels.dtype == (np.uint16 if name == "bayer12" else np.uint8)
    assert all(abs(image.exposure_us - 5000) < 60 and image.gain_db < 0.05 for image in images)
    assert (np.diff([image.device_ticks for image in images]) > 0).all()
    assert (state.get("ExposureAuto", "Off"), state.get("GainAuto", "Off")) == ("Off", "Off")


def test_a_picture_takes_little_more_than_its_exposure(serial):
    with Basler(SETTINGS, Device(serial=serial)) as camera:
        camera.grab()
        begun = time.monotonic()
        for _ in range(10):
            camera.grab()
    assert (time.monotonic() - begun) / 10 < 0.2


def test_longer_exposures_are_brighter(serial):
    means = []
    for exposure_us in (500, 8000):
        with Basler(SETTINGS.model_copy(update={"exposure_us": exposure_us}), Device(serial=serial)) as camera:
            means.append(camera.grab().pixels.mean())
    assert means[1] > means[0]  # take the cap off
