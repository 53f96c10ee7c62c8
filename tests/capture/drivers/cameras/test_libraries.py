"""What is said where the library of a camera's maker is there, but not what it needs of the system."""

import sys
from pathlib import Path

import pytest

from koala3d.capture.drivers.cameras.realsense import RealSense
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings


def test_a_library_that_cannot_be_loaded_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pyrealsense2.py").write_text("raise ImportError('libusb-1.0.so.0: cannot open shared object file')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    with pytest.raises(CaptureError, match=r"cannot be loaded \(libusb-1\.0\.so\.0: .*apt install libusb-1\.0-0"):
        RealSense(CameraSettings(), Device(model="realsense")).__enter__()
