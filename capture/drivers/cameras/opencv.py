"""Webcams, films and numbered pictures through OpenCV's VideoCapture.

A webcam sends pictures all the time and buffers some: those of before the request are thrown away. Its exposure has other units
with every system (`_EXPOSURE`), and its gain none. A system may ignore a setting in silence, so everything is read back.
"""

import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.capture.drivers.cameras import refusals
from koala3d.capture.drivers.cameras.deadline import PatientCamera
from koala3d.capture.drivers.cameras.nodes import put, put_all
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image, Pixels
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

ANSWER_S = 5.0  # longest time for an answer beyond the exposure [s]
STALE = 5  # pictures that a webcam may have buffered: four in V4L2, and the one that is being exposed
AUTOMATICS = {"AUTO_WB": 0.0, "AUTOFOCUS": 0.0}
"""Automatic functions, and the values that switch them off; many webcams have none of them."""
MANUAL = {"V4L2": 1.0, "DSHOW": 0.0, "MSMF": 0.0}  # values of AUTO_EXPOSURE
_EXPOSURE: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "V4L2": (lambda us: us / 100, lambda value: value * 100),
    "DSHOW": (lambda us: float(np.log2(us * 1e-6)), lambda value: 2.0**value * 1e6),
    "MSMF": (lambda us: float(np.log2(us * 1e-6)), lambda value: 2.0**value * 1e6),
}
"""For each of OpenCV's interfaces: from microseconds to its EXPOSURE, and back. Linux: 0.1 ms a step; Windows: log2 of s."""
STATE = """AUTOFOCUS AUTO_EXPOSURE AUTO_WB BACKEND BACKLIGHT BRIGHTNESS BUFFERSIZE CONTRAST CONVERT_RGB EXPOSURE FOCUS FOURCC FPS
FRAME_COUNT FRAME_HEIGHT FRAME_WIDTH GAIN GAMMA HUE SATURATION SHARPNESS TEMPERATURE WB_TEMPERATURE ZOOM""".split()
"""Properties that the manifest keeps, by OpenCV's names without CAP_PROP_."""


class OpenCvCamera(PatientCamera):
    """One webcam, or a film or numbered pictures that are shown one after the other.

    Args:
        device: `source` is the number of a webcam (0 is the first), a film, or a pattern such as `shots/%03d.png`.

    A film has neither exposure nor gain: both must be in `device.leave`, and are then recorded as the trajectory states them.

    Raises:
        RigConnectionError: there is no such device or file, or it does not answer in time.
        CaptureError: a setting was rejected (requested and actual value), or no picture is left.
    """

    open_s, set_up_s, answer_s = 10.0, ANSWER_S, ANSWER_S

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        super().__init__(settings, device)
        self._exposure_us, self._taken = settings.exposure_us, 0

    def grab(self) -> Image:
        """The next picture of a film, or one that a webcam has exposed after this call."""
        begun, exposure_us = time.monotonic_ns(), self._exposure_us
        pixels, ticks = self._call(ANSWER_S + (STALE + 1) * exposure_us * 1e-6, self._read)
        self._taken += 1
        return Image(pixels, exposure_us, self.settings.gain_db, ticks, begun)

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises CaptureError: the camera rejects it."""
        self._call(ANSWER_S, self._set_exposure, exposure_us)

    def description(self) -> dict[str, Any]:
        """Source, size, exposure, and all properties that OpenCV can read."""
        self._require_open()
        nodes, backend = self.nodes, self._camera.getBackendName()
        return {
            "driver": "opencv",
            "model": f"{'webcam' if self._is_live else 'film'}, {backend}",
            "serial": self.device.serial,
            "source": self.device.source,
            "sensor": {"width": self.settings.width, "height": self.settings.height},
            "exposure_us": self._exposure_us,
            "gain_db": self.settings.gain_db,
            "pixel_format": self.settings.pixel_format,
            "left": list(self.device.leave),
            "state": {name: nodes.read(name) for name in STATE if nodes.has(name)},
        }

    @property
    def _is_live(self) -> bool:
        return is_live(self.device.source)

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"camera {self.serial}"

    @property
    def nodes(self) -> "CaptureNodes":
        """Its properties."""
        return CaptureNodes(self._camera)

    @property
    def serial(self) -> str:
        """Its source: OpenCV knows no serial numbers."""
        return self.device.source or "0"

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        """OpenCV's own say nothing that a person could use."""
        return False

    def _connect(self) -> None:
        import cv2

        source, number = self.serial, self._is_live
        if not number and "%" not in source and not Path(source).is_file():
            remedy = "camera.source takes the number of a webcam, a film, or numbered pictures such as shots/%03d.png"
            raise RigConnectionError("no such file", where=source, remedy=remedy)
        capture = cv2.VideoCapture(int(source)) if number else cv2.VideoCapture(source)
        if not capture.isOpened():
            capture.release()
            why = "no webcam has this number, or another program uses it" if number else "OpenCV cannot read it"
            raise RigConnectionError("camera cannot be opened", where=self.name, why=why, remedy="check camera.source")
        self._camera = capture

    def _configure(self) -> None:
        import cv2

        wanted, where, capture = self.settings, self.name, self._camera
        refusals.refuse_format(wanted, ("rgb8",), where)
        refusals.refuse_region(wanted, where)
        nodes = self.nodes
        if self._is_live:
            for name, value in AUTOMATICS.items():
                if nodes.has(name):
                    put(nodes, name, value)
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.width)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.height)
        actual = (round(nodes.read("FRAME_WIDTH")), round(nodes.read("FRAME_HEIGHT")))
        refusals.refuse_size(wanted, actual, where)
        if "exposure_us" not in self.device.leave:
            if self._is_live and nodes.has("AUTO_EXPOSURE"):
                put(nodes, "AUTO_EXPOSURE", MANUAL.get(capture.getBackendName(), 0.0))
            self._set_exposure(wanted.exposure_us)
        refusals.require_left(self.device, "gain_db", "OpenCV's gain has no unit", where)
        put_all(nodes, self.device.settings, where)

    def _set_exposure(self, exposure_us: float) -> None:
        where, backend, nodes = self.name, self._camera.getBackendName(), self.nodes
        if not self._is_live or backend not in _EXPOSURE or "exposure_us" in self.device.leave:
            why = "a film was exposed before" if not self._is_live else f"{backend} does not say in which unit"
            remedy = "list exposure_us in camera.leave, and take no brackets"
            raise CaptureError("camera takes no exposure time", where=where, why=why, remedy=remedy)
        there, back = _EXPOSURE[backend]
        nodes.write("EXPOSURE", there(exposure_us))
        actual = back(nodes.read("EXPOSURE"))
        if abs(actual - exposure_us) > refusals.SHARE * exposure_us:
            why, remedy = f"requested {exposure_us:g}, actual {actual:g}", "change the camera settings of the trajectory"
            raise CaptureError("camera changed the exposure time", where=where, why=why, remedy=remedy)
        self._exposure_us = actual

    def _read(self) -> tuple[Pixels, int]:
        """The picture, and the device's time stamp [ns], of a film that in the film."""
        import cv2

        for _ in range(STALE if self._is_live else 0):
            self._camera.grab()
        good, picture = self._camera.read()
        if not good or picture is None:
            why, remedy = f"{self._taken} were taken", "provide one picture per view"
            if self._is_live:
                raise RigConnectionError("camera gave no image", where=self.name, remedy="check its cable; use --resume")
            raise CaptureError("no picture is left", where=self.name, why=why, remedy=remedy)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            why, remedy = f"{picture.dtype} {picture.shape}", "give colours of 8 bits"
            raise CaptureError("camera sent another format", where=self.name, why=why, remedy=remedy)
        refusals.refuse_size(self.settings, (picture.shape[1], picture.shape[0]), self.name)
        stamp_ms = float(self._camera.get(cv2.CAP_PROP_POS_MSEC))
        return np.ascontiguousarray(picture[..., ::-1]), round(max(stamp_ms, 0.0) * 1e6)  # OpenCV's colours are BGR

    def _release(self, camera: Any) -> None:
        camera.release()


class CaptureNodes:
    """`capture.drivers.cameras.nodes.Nodes` of a VideoCapture: its properties, by OpenCV's names without CAP_PROP_."""

    def __init__(self, capture: Any) -> None:
        import cv2

        self._capture = capture
        prefix = "CAP_PROP_"
        self._numbers = {name.removeprefix(prefix): int(getattr(cv2, name)) for name in dir(cv2) if name.startswith(prefix)}

    def has(self, name: str) -> bool:
        """OpenCV answers -1 or 0 for a property that is not there; 0 may also be a value, so writing decides."""
        return name in self._numbers and self.read(name) != -1.0

    def read(self, name: str) -> float:
        """Its value."""
        return float(self._capture.get(self._numbers[name]))

    def symbolics(self, name: str) -> Collection[str]:
        """None: all are numbers."""
        return ()

    def write(self, name: str, value: Any) -> None:
        """Set a number. Raises CaptureError: the device does not take it."""
        try:
            taken = self._capture.set(self._numbers[name], float(value))
        except (TypeError, ValueError):
            raise CaptureError(f"camera rejected {name}", why=f"{value!r} is no number", remedy="give a number") from None
        if not taken:
            why, remedy = f"requested {value}, it stays at {self.read(name):g}", "remove it, or use another camera"
            raise CaptureError(f"camera rejected {name}", why=why, remedy=remedy)


def is_live(source: str) -> bool:
    """Whether a source is a webcam; an empty one is the first."""
    return source.isdigit() or not source
