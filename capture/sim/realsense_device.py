"""A RealSense D435 of librealsense's own making: a software device, which sends whatever picture and depth it was given last.

It has modes, options and their ranges as the real one, and streams all the time, so that the driver really runs.
"""

import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera

SERIAL = "000000000435"
COLOUR_MODES = ((1920, 1080), (1280, 720), (960, 540), (848, 480), (640, 480), (640, 360), (424, 240), (320, 240), (320, 180))
DEPTH_MODES = ((1280, 720), (848, 480), (640, 480), (640, 360), (480, 270), (424, 240))
RATES = (6, 15, 30, 60)
UNIT_M = 1e-3
BASELINE_M = 0.015
"""From the left infrared sensor, whose view depth has, to the colour sensor."""
DEPTH_FOCAL = 640 / 1280
"""Focal length of depth over the width of its picture: 90 degrees across."""
SENDING_HZ = 100.0  # faster than any real camera: whoever waits for a fresh picture waits shorter
COLOUR_OPTIONS = {
    "exposure": (1, 10000, 156, 1),
    "gain": (0, 128, 64, 1),
    "white_balance": (2800, 6500, 4600, 10),
    "enable_auto_exposure": (0, 1, 1, 1),
    "enable_auto_white_balance": (0, 1, 1, 1),
    "auto_exposure_priority": (0, 1, 0, 1),
    "backlight_compensation": (0, 1, 0, 1),
    "brightness": (-64, 64, 0, 1),
    "contrast": (0, 100, 50, 1),
    "gamma": (100, 500, 300, 1),
    "hue": (-180, 180, 0, 1),
    "saturation": (0, 100, 64, 1),
    "sharpness": (0, 100, 50, 1),
}
DEPTH_OPTIONS = {"emitter_enabled": (0, 2, 1, 1), "laser_power": (0, 360, 150, 30)}
"""Smallest and largest value, the factory's, and the step."""


class SoftwareRealSense:
    """`capture.drivers.cameras.realsense.Emulation`.

    Args:
        sensor_camera: camera of the whole colour sensor; its modes are scaled pictures of it, cut to their shape.
        usb: what it says of its link.
        together: one sensor sends colours and depth, as in a D405.
    """

    def __init__(self, sensor_camera: Camera, *, usb: str = "3.2", together: bool = False) -> None:
        import pyrealsense2

        rs: Any = pyrealsense2
        self._rs, self.sensor_camera, self.device = rs, sensor_camera, rs.software_device()
        for name, text in (
            ("name", "Intel RealSense D435"),
            ("serial_number", SERIAL),
            ("firmware_version", "5.17.0.10"),
            ("usb_type_descriptor", usb),
        ):
            self.device.register_info(getattr(rs.camera_info, name), text)
        stereo = self.device.add_sensor("Stereo Module")
        colour = stereo if together else self.device.add_sensor("RGB Camera")
        self._sensors = {"color": colour, "depth": stereo}
        self._profiles: dict[tuple[str, int, int], Any] = {}
        self._add_modes()
        for sensor, options in ((colour, COLOUR_OPTIONS), (stereo, DEPTH_OPTIONS)):
            for name, (low, high, default, step) in options.items():
                sensor.add_option(getattr(rs.option, name), rs.option_range(low, high, default, step), True)
                sensor.set_option(getattr(rs.option, name), default)
        stereo.add_read_only_option(rs.option.depth_units, UNIT_M)
        stereo.add_read_only_option(rs.option.asic_temperature, 38.0)
        self._shown: dict[str, NDArray[np.generic]] = {}
        self._sent = 0
        self._running = threading.Event()
        self._thread: threading.Thread | None = None

    def colour_camera(self, width: int, height: int) -> Camera:
        """The camera of a mode: the largest part of the sensor of that shape, scaled."""
        return mode_camera(self.sensor_camera, width, height)

    @staticmethod
    def depth_camera(width: int, height: int) -> Camera:
        """The camera of a mode of depth."""
        return Camera(width, height, DEPTH_FOCAL * width, DEPTH_FOCAL * width, width / 2, height / 2)

    def show(self, pixels: NDArray[np.uint8], depth: NDArray[np.uint16] | None = None) -> None:
        """Send this picture and this depth from now on; (height, width, 3) and (height, width) in `UNIT_M`."""
        shown: dict[str, NDArray[np.generic]] = {"color": np.ascontiguousarray(pixels)}
        if depth is not None:
            shown["depth"] = np.ascontiguousarray(depth)
        self._shown = shown

    def start(self) -> None:
        """See `Emulation`."""
        self._running.set()
        self._thread = threading.Thread(target=self._send, name="software RealSense", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """See `Emulation`."""
        self._running.clear()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _add_modes(self) -> None:
        rs, number = self._rs, 0
        for kind, modes, format_, size, camera in (
            ("color", COLOUR_MODES, rs.format.rgb8, 3, self.colour_camera),
            ("depth", DEPTH_MODES, rs.format.z16, 2, self.depth_camera),
        ):
            for width, height in modes:
                for rate in RATES:
                    stream = rs.video_stream()
                    stream.type, stream.fmt, stream.index, stream.uid = getattr(rs.stream, kind), format_, 0, number
                    stream.width, stream.height, stream.fps, stream.bpp = width, height, rate, size
                    stream.intrinsics = self._intrinsics(camera(width, height))
                    self._profiles[kind, width, height] = self._sensors[kind].add_video_stream(stream)
                    number += 1
        between = rs.extrinsics()
        between.rotation, between.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-BASELINE_M, 0, 0]
        for depth in (one for key, one in self._profiles.items() if key[0] == "depth"):
            for colour in (one for key, one in self._profiles.items() if key[0] == "color"):
                depth.register_extrinsics_to(colour, between)

    def _intrinsics(self, camera: Camera) -> Any:
        found = self._rs.intrinsics()
        found.width, found.height, found.fx, found.fy = camera.width, camera.height, camera.fx, camera.fy
        found.ppx, found.ppy = camera.cx - 0.5, camera.cy - 0.5  # centres of pixels are at integers there
        found.model, found.coeffs = self._rs.distortion.none, [0.0] * 5
        return found

    def _send(self) -> None:
        while self._running.is_set():
            self._sent += 1
            for kind, picture in self._shown.items():
                height, width = picture.shape[:2]
                frame = self._rs.software_video_frame()
                frame.bpp = picture.itemsize * (picture.shape[2] if picture.ndim == 3 else 1)
                frame.pixels, frame.stride = picture.view(np.uint8), frame.bpp * width
                frame.timestamp, frame.domain = time.monotonic() * 1e3, self._rs.timestamp_domain.system_time
                frame.frame_number, frame.profile = self._sent, self._profiles[kind, width, height].as_video_stream_profile()
                if kind == "depth":
                    frame.depth_units = UNIT_M
                self._sensors[kind].on_video_frame(frame)
            time.sleep(1 / SENDING_HZ)


def mode_camera(sensor: Camera, width: int, height: int) -> Camera:
    """The camera of pictures of `width` x `height` that show the largest part of a sensor of that shape, scaled."""
    from dataclasses import replace

    scale = max(width / sensor.width, height / sensor.height)
    scaled = sensor.scaled(round(sensor.width * scale), round(sensor.height * scale))
    left, upper = (scaled.width - width) / 2, (scaled.height - height) / 2
    return replace(scaled, width=width, height=height, cx=scaled.cx - left, cy=scaled.cy - upper)
