"""Through librealsense, on its software device."""

import numpy as np
import pytest

from koala3d.capture.drivers.cameras.realsense import RealSense
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.sim.emulated import STEREO_BASELINE_M, stereo_depth
from koala3d.capture.sim.realsense_device import BASELINE_M, SERIAL, SoftwareRealSense, mode_camera
from koala3d.datasets.camera_model import Camera

pytest.importorskip("pyrealsense2", exc_type=ImportError)  # or its libusb is absent

SENSOR = Camera(1920, 1080, 1380.0, 1381.0, 950.0, 545.0, k1=-0.1)
SETTINGS = CameraSettings(width=320, height=240)


def device(**changes) -> Device:
    depth = {"width": 424, "height": 240}
    return Device.model_validate({"model": "realsense", "leave": ["gain_db"], "depth": depth, **changes})


def shown(source: SoftwareRealSense, level: int) -> None:
    source.show(np.full((240, 320, 3), level, np.uint8), np.full((240, 424), 10 * level, np.uint16))


@pytest.mark.parametrize("together", [False, True], ids=["two sensors", "one sensor, as a D405"])
def test_a_picture_and_its_depth_are_of_after_the_request(together):
    """The device sends the old ones all the time; none of them may be taken for the new."""
    source = SoftwareRealSense(SENSOR, together=together)
    shown(source, 1)
    with RealSense(SETTINGS, device(), emulation=source) as camera:
        for level in (20, 40, 60):
            shown(source, level)
            image = camera.grab()
            assert (image.pixels == level).all() and image.depth is not None and (image.depth == 10 * level).all()


def test_settings_are_brought_to_a_known_state_and_then_to_the_rig_files():
    source = SoftwareRealSense(SENSOR)
    shown(source, 1)
    first = device(settings={"contrast": 80, "white_balance": 3000, "depth.emitter_enabled": 0})
    for wanted, expected in ((first, (80, 3000, 0)), (device(), (50, 4600, 0))):
        with RealSense(SETTINGS, wanted, emulation=source) as camera:
            state = camera.description()["state"]
        assert tuple(state[key] for key in ("contrast", "white_balance", "depth.emitter_enabled")) == expected
        assert (state["enable_auto_exposure"], state["exposure"]) == (0, 100)


def test_the_description_says_how_depth_is_read():
    source = SoftwareRealSense(SENSOR)
    with RealSense(SETTINGS, device(), emulation=source) as camera:
        said = camera.description()
    depth = said["depth"]
    assert depth["unit_m"] == 0.001 and said["serial"] == SERIAL
    assert Camera.from_json(depth["camera"], where="depth") == SoftwareRealSense.depth_camera(424, 240)
    np.testing.assert_allclose(np.array(depth["camera_from_depth"])[:3, 3], [-BASELINE_M, 0, 0], atol=1e-8)
    own = Camera.from_json(said["factory_camera"]["camera"], where="colour")
    wanted = mode_camera(SENSOR, 320, 240)
    np.testing.assert_allclose([own.fx, own.fy, own.cx, own.cy], [wanted.fx, wanted.fy, wanted.cx, wanted.cy], rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"leave": []}, "takes no gain_db .its gain has no unit.*list gain_db"),
        ({"settings": {"gain": 999}}, "rejected gain .requested 999, possible: 0 to 128"),
        ({"settings": {"white_balance": 4601}}, "rejected white_balance"),
        ({"settings": {"zoom": 1}}, "has no setting zoom"),
        ({"depth": {"width": 100, "height": 100}}, "no such depth mode .*424x240"),
        ({"serial": "77"}, f"camera 77: no RealSense camera was found .connected: {SERIAL}"),
    ],
)
def test_what_the_camera_cannot_do_is_said(changes, words):
    with pytest.raises(CaptureError, match=words):
        RealSense(SETTINGS, device(**changes), emulation=SoftwareRealSense(SENSOR)).__enter__()


def test_without_a_camera_there_is_one_clear_line():
    try:
        RealSense(SETTINGS, device()).__enter__()
    except RigConnectionError as error:
        assert "no RealSense camera was found" in str(error) and "udev" in str(error)
    else:
        pytest.skip("a RealSense camera is connected to this computer")


def test_a_camera_that_stops_sending_is_an_error_within_the_deadline(monkeypatch):
    monkeypatch.setattr("koala3d.capture.drivers.cameras.realsense.TRANSFER_MS", 50)
    source = SoftwareRealSense(SENSOR)
    shown(source, 1)
    with RealSense(SETTINGS, device(), emulation=source) as camera:
        camera.grab()
        source.stop()
        with pytest.raises(RigConnectionError, match=r"gave no image .*check its cable"):
            camera.grab()


def test_a_mode_shows_the_largest_part_of_the_sensor():
    pinhole = SENSOR.undistorted()  # whose edges are straight
    for width, height in ((1920, 1080), (640, 480), (424, 240)):
        mode = mode_camera(pinhole, width, height)
        corners = mode.directions(np.array([[0, 0], [width, height]], float))
        whole = pinhole.directions(np.array([[0, 0], [SENSOR.width, SENSOR.height]], float))
        inside = (np.abs(corners[..., :2]) <= np.abs(whole[..., :2]) + 2 / SENSOR.fx).all()
        assert inside and np.isclose(corners[:, :2], whole[:, :2], atol=2 / mode.fx).all(0).any(), (
            "one pair of edges is the sensor's"
        )


def test_depth_has_the_noise_of_its_disparity():
    true = np.full((240, 424), 0.5, np.float32)
    true[:, :10] = 0
    true[:, 10:20] = 0.05
    measured = stereo_depth(true, 212.0, np.random.default_rng(0))
    assert not measured[:, :20].any(), "nothing is there, or it is too near"
    # z^2 sigma / (f b), and the step of 1 mm; 97000 values give the standard deviation to 0.3 %
    wanted = np.hypot(1e3 * 0.25 * 0.08 / (212.0 * STEREO_BASELINE_M), 1 / np.sqrt(12))
    assert measured[:, 20:].std() == pytest.approx(wanted, rel=0.03)
