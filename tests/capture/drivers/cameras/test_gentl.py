"""Through harvesters, on the GenTL producer that comes with the genicam package: a camera that shows a game."""

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from koala3d.capture.doctor.camera import check
from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.drivers.cameras import genicam as shared
from koala3d.capture.drivers.cameras.gentl import PATHS, GenTlCamera
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import CameraSettings

pytest.importorskip("harvesters")
genicam = pytest.importorskip("genicam")

PRODUCER = str(Path(genicam.__file__).parent / "viky.cti")
ALL = ["exposure_us", "gain_db", "colour_space", "factory_settings", "trigger"]
SETTINGS = CameraSettings(width=104, height=104)
BALL = {"BouncingBallSize": 40, "AcquisitionFrameRate": 200.0}


def device(**changes) -> Device:
    return Device.model_validate(
        {"model": "genicam", "source": PRODUCER, "serial": "1", "leave": ALL, "settings": BALL, **changes}
    )


def test_pictures_move_on_in_colour_and_in_grey():
    for name, channels in (("rgb8", 3), ("mono8", 1)):
        with GenTlCamera(SETTINGS.model_copy(update={"pixel_format": name}), device()) as camera:
            first, second = camera.grab(), camera.grab()
            state = camera.description()["state"]
        assert first.pixels.shape == (104, 104, channels) and (first.pixels != second.pixels).any(), "the ball has moved"
        assert (state["BouncingBallSize"], state["Width"]) == (40, 104)
        assert np.unique(first.pixels).size > 1


def test_old_pictures_are_thrown_away_and_counted():
    with GenTlCamera(SETTINGS, device()) as camera:
        time.sleep(0.2)
        camera._drain()
        first = camera._number
        time.sleep(0.2)
        camera._drain()
        assert first is not None and camera._number > first + 1


def test_a_stream_starts_again_after_a_picture_that_did_not_come(monkeypatch):
    with GenTlCamera(SETTINGS, device()) as camera:
        before = [camera._expose().number for _ in range(4)][-1]
        with monkeypatch.context() as patched, pytest.raises(RigConnectionError, match=r"gave no image .nothing within"):
            patched.setattr(shared, "TRANSFER_S", -0.0095)  # the exposure time of the trajectory is 10 ms
            camera.grab()
        camera.grab()
        assert camera._expose().number < before, "numbers begin again"


def test_what_a_camera_sends_with_a_picture_is_read(monkeypatch):
    """The producer counts the bounces of its ball; it has no exposure."""
    monkeypatch.setattr(shared, "CHUNKS", ("NrBounces",))
    with GenTlCamera(SETTINGS, device()) as camera:
        delivered = camera._expose()
    assert delivered.chunks.keys() == {"NrBounces"} and delivered.chunks["NrBounces"] >= 0


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_still_interrupts_while_the_camera_is_open_and_afterwards():
    with GenTlCamera(SETTINGS, device()) as camera, pytest.raises(KeyboardInterrupt):
        camera.grab()
        signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        ("exposure_us", "takes no exposure time .it has no ExposureTime.*list exposure_us in camera.leave"),
        ("gain_db", "takes no gain_db .it has no Gain"),
        ("colour_space", "cannot send sRGB"),
        ("factory_settings", "takes no factory_settings .it has no UserSetLoad"),
        ("trigger", "takes no trigger .it has no TriggerMode"),
    ],
)
def test_what_the_camera_lacks_must_be_left_on_purpose(lacking, words):
    with pytest.raises(CaptureError, match=words):
        GenTlCamera(SETTINGS, device(leave=[one for one in ALL if one != lacking])).__enter__()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"settings": {"BouncingBallSize": 41}}, "rejected BouncingBallSize .requested 41: .*Max = 40"),
        ({"settings": {"BallColour": 1}}, "has no setting BallColour"),
        ({"serial": "9"}, "camera 9: no GenICam camera was found .connected: Viky 0, Viky 1, Viky 2"),
        ({"serial": ""}, "several GenICam cameras are connected .Viky 0.*write the serial number"),
        ({"source": "none.cti"}, "none.cti: no such GenTL producer"),
        ({"source": __file__}, "whether the producer can be loaded"),
    ],
)
def test_what_is_wrong_is_said(changes, words):
    with pytest.raises(CaptureError, match=words):
        GenTlCamera(SETTINGS, device(**changes)).__enter__()


def test_producers_are_found_by_the_standards_variable(monkeypatch):
    monkeypatch.setenv(PATHS, str(Path(PRODUCER).parent))
    with GenTlCamera(SETTINGS, device(source="")).inspected() as found:
        assert found.serial == "1" and found.nodes.read("PixelFormat") in found.nodes.symbolics("PixelFormat")
    monkeypatch.setenv(PATHS, "")
    with pytest.raises(RigConnectionError, match=f"no GenTL producer .*{PATHS} names none"):
        GenTlCamera(SETTINGS, device(source="")).__enter__()


def test_the_doctor_asks_it_and_says_what_is_left():
    rig = RigDescription.model_validate({"camera": device().model_dump()})
    with GenTlCamera(SETTINGS, device()).inspected() as found:
        lines = {line.name: line for line in check(found.nodes, found.serial, {}, rig.camera, genicam=True)}
        strict = {line.name: line for line in check(found.nodes, found.serial, {}, RigDescription().camera, genicam=True)}
    assert lines["camera serial"].verdict is Verdict.OK
    assert "factory_settings in camera.leave" in lines["factory settings"].remedy
    assert lines["colour space"].verdict is Verdict.UNKNOWN and strict["colour space"].verdict is Verdict.WRONG
