"""What the doctor says about cameras that do not follow GenICam; on librealsense's software device and OpenCV's readers."""

import numpy as np
import pytest

from koala3d.capture.doctor.camera import check
from koala3d.capture.doctor.examine import examine
from koala3d.capture.doctor.lines import Verdict
from koala3d.capture.model.device import Device
from koala3d.capture.model.rig import CameraDescription, RigDescription
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.capture.rig.cameras import seen
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images

SENSOR = Camera(1920, 1080, 1380.0, 1380.0, 960.0, 540.0)


@pytest.mark.parametrize(
    ("usb", "stated", "wrong"),
    [
        ("3.2", {}, set()),
        ("2.1", {}, {"camera link"}),
        ("3.2", {"serial": "7"}, {"camera serial"}),
        ("3.2", {"firmware": "1.0"}, {"camera firmware"}),
        ("3.2", {"settings": {"gain": 500}}, {"camera settings"}),
        ("3.2", {"settings": {"zoom": 1}}, {"camera settings"}),
        ("2.1", {"serial": "7", "settings": {"gain": 500}}, {"camera link", "camera serial", "camera settings"}),
    ],
)
def test_what_is_wrong_with_a_realsense_is_named_and_nothing_else(usb, stated, wrong):
    pytest.importorskip("pyrealsense2", exc_type=ImportError)  # or its libusb is absent
    from koala3d.capture.drivers.cameras.realsense import RealSense
    from koala3d.capture.sim.realsense_device import SoftwareRealSense

    description = CameraDescription.model_validate({"model": "realsense", "depth": {}, **stated})
    asked = Device(model="realsense", depth=description.depth)
    with RealSense(CameraSettings(), asked, emulation=SoftwareRealSense(SENSOR, usb=usb)).inspected() as found:
        lines = check(found.nodes, found.serial, found.facts, description)
    assert {line.name for line in lines if line.verdict is Verdict.WRONG} == wrong
    assert all(line.remedy for line in lines if line.verdict is not Verdict.OK)


def test_what_a_film_cannot_say_is_unknown(tmp_path):
    images.write(tmp_path / "000.png", np.zeros((48, 64, 3), np.uint8))
    description = CameraDescription.model_validate({"model": "opencv", "source": str(tmp_path / "%03d.png")})
    with seen(description) as found:
        lines = check(found.nodes, found.serial, found.facts, description)
    verdicts = {line.name: line.verdict for line in lines}
    assert verdicts.pop("camera settings") is Verdict.OK
    assert set(verdicts.values()) == {Verdict.UNKNOWN}
    assert all(line.remedy for line in lines if line.verdict is Verdict.UNKNOWN)


def test_a_camera_that_cannot_be_opened_is_one_wrong_line(tmp_path):
    rig = RigDescription.model_validate({"robot": {"model": "panda"}, "camera": {"model": "opencv", "source": "97"}})
    lines = examine(rig, "", tmp_path, simulated=False, seconds=0.1)
    assert [line.name for line in lines if line.verdict is Verdict.WRONG] == ["camera serial"]
    assert "no webcam has this number" in next(line.found for line in lines if line.name == "camera serial")
