"""Through OpenCV's own readers, on real files. A webcam needs one: tests/hardware/test_cameras.py."""

import cv2
import numpy as np
import pytest

from koala3d.capture.drivers.cameras.opencv import _EXPOSURE, OpenCvCamera
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.datasets.imaging import images

SETTINGS = CameraSettings(width=64, height=48)
LEFT = ["exposure_us", "gain_db"]


@pytest.fixture(scope="module")
def pictures():
    return [np.random.default_rng(number).integers(0, 255, (48, 64, 3), np.uint8) for number in range(3)]


@pytest.fixture(scope="module")
def numbered(pictures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("shots")
    for number, picture in enumerate(pictures):
        images.write(folder / f"{number:03d}.png", picture)
    return str(folder / "%03d.png")


@pytest.fixture(scope="module")
def film(pictures, tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 10, (64, 48))
    for picture in pictures:
        writer.write(picture[..., ::-1])
    writer.release()
    return str(path)


def device(source: str, **changes) -> Device:
    return Device.model_validate({"model": "opencv", "source": source, "leave": LEFT, **changes})


@pytest.mark.parametrize("kind", ["numbered", "film"])
def test_pictures_come_one_after_the_other_bit_for_bit_until_none_is_left(pictures, kind, request):
    with OpenCvCamera(SETTINGS, device(request.getfixturevalue(kind))) as camera:
        seen = [camera.grab() for _ in pictures]
        with pytest.raises(CaptureError, match=r"no picture is left \(3 were taken\); provide one picture per view"):
            camera.grab()
    assert all(np.array_equal(one.pixels, picture) for one, picture in zip(seen, pictures, strict=True))
    assert (np.diff([one.device_ticks for one in seen]) > 0).all()


def test_what_a_film_cannot_take_must_be_left_on_purpose(numbered):
    with pytest.raises(CaptureError, match=r"takes no exposure time .*list exposure_us in camera.leave"):
        OpenCvCamera(SETTINGS, device(numbered, leave=["gain_db"])).__enter__()
    with pytest.raises(CaptureError, match=r"takes no gain_db .*OpenCV's gain has no unit"):
        OpenCvCamera(SETTINGS, device(numbered, leave=["exposure_us"])).__enter__()
    with OpenCvCamera(SETTINGS, device(numbered)) as camera:
        assert camera.description()["left"] == LEFT


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"GAIN": 3}, r"rejected GAIN \(requested 3, it stays at 0\)"),
        ({"GAYN": 3}, "has no setting GAYN"),
        ({"GAIN": "high"}, "'high' is no number"),
    ],
)
def test_a_setting_that_the_device_does_not_take_is_refused(numbered, settings, words):
    with pytest.raises(CaptureError, match=words):
        OpenCvCamera(SETTINGS, device(numbered, settings=settings)).__enter__()


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("none.mp4", "none.mp4: no such file"),
        ("97", "camera 97: camera cannot be opened .no webcam"),
        (__file__, "OpenCV cannot"),
    ],
)
def test_what_is_no_camera_is_an_error(source, words):
    with pytest.raises(RigConnectionError, match=words):
        OpenCvCamera(SETTINGS, device(source)).__enter__()


def test_units_of_exposure_go_there_and_back():
    for there, back in _EXPOSURE.values():
        assert back(there(10_000.0)) == pytest.approx(10_000.0)
    assert _EXPOSURE["V4L2"][0](10_000.0) == 100 and _EXPOSURE["DSHOW"][0](1e6 / 64) == -6


def test_it_can_be_looked_at(film):
    with OpenCvCamera(CameraSettings(), device(film)).inspected() as found:
        assert found.nodes.read("FRAME_WIDTH") == 64 and found.serial == film
