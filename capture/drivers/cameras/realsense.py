"""Intel RealSense cameras through librealsense: the picture of the colour sensor and, on request, depth beside it.

Depth is what the camera measured, with the errors of such sensors. It is kept with its unit, its own intrinsics and its place
relative to the colour sensor, as the factory's calibration has them, and never used as truth.

The sensors send pictures all the time. Those of before a request are thrown away.
"""

import time
from typing import Any, Protocol

import numpy as np

from koala3d.capture.drivers.cameras import refusals
from koala3d.capture.drivers.cameras.base import CameraDriver, only_one
from koala3d.capture.drivers.cameras.nodes import put, put_all
from koala3d.capture.drivers.cameras.realsense_options import OptionNodes, factory_camera, rigid, set_start_state
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

STALE = 2  # pictures that may have been exposed before the request: one on its way, and one that is being exposed
TRANSFER_MS = 3000  # longest time for a picture beyond its exposure [ms]
STEP_US = 100.0
"""Unit of the exposure of a colour sensor of its own; where colours come from the stereo module (D405) it is 1 us."""


class Emulation(Protocol):
    """A device of librealsense that a program feeds, in place of a real one."""

    device: Any

    def start(self) -> None:
        """The streams have been started."""

    def stop(self) -> None:
        """They are about to be stopped."""


class RealSense(CameraDriver):
    """One RealSense camera with fixed exposure, gain and white balance.

    Its gain has no unit: `gain_db` must be in `device.leave`, and `gain` may be in `device.settings`.

    Time: `device_ticks` is the frame's time stamp [ns], in the domain that the description names.

    Raises:
        RigConnectionError: there is no camera, or several and no serial number, or it is busy or unplugged.
        CaptureError: a setting or a mode was rejected (with what is possible).
    """

    busy = f"{CameraDriver.busy}, at a USB 3 port"

    def __init__(self, settings: CameraSettings, device: Device, *, emulation: Emulation | None = None) -> None:
        super().__init__(settings, device)
        self._emulation = emulation
        self._rs: Any = None
        self._sensors: list[Any] = []  # started ones
        self._colour: Any = None
        self._depth: Any = None
        self._profiles: tuple[Any, Any] = (None, None)
        self._queues: tuple[Any, Any] = (None, None)
        self._exposure_us = settings.exposure_us

    def grab(self) -> Image:
        """The first picture, and depth, that was exposed after this call."""
        self._require_open()
        begun, patience_ms = time.monotonic_ns(), TRANSFER_MS + round(self._exposure_us / 1000)
        try:
            frames = [None if queue is None else _fresh(queue, patience_ms) for queue in self._queues]
        except RuntimeError as error:
            remedy = "check its cable and resume with --resume"
            raise RigConnectionError("camera gave no image", where=self.name, why=str(error), remedy=remedy) from None
        colour, depth = frames
        assert colour is not None  # there is always a queue for it
        measured = None if depth is None else np.array(np.asanyarray(depth.get_data()), np.uint16)
        pixels, ticks = np.array(np.asanyarray(colour.get_data()), np.uint8), round(colour.get_timestamp() * 1e6)
        return Image(pixels, self._exposure_us, self.settings.gain_db, ticks, begun, depth=measured)

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises CaptureError: the camera rejects it."""
        self._require_open()
        if "exposure_us" in self.device.leave:
            why, remedy = "camera.leave names it", "take exposure_us out of camera.leave, or take no brackets"
            raise CaptureError("camera takes no exposure time", where=self.name, why=why, remedy=remedy)
        longest_us = 1e6 / self._profiles[0].fps()
        refusals.refuse_impossible(exposure_us, 1.0, longest_us, f"exposure at {self._profiles[0].fps()} Hz", self.name)
        step_us = 1.0 if self._colour_is_stereo else STEP_US
        value = float(round(exposure_us / step_us))
        if abs(value * step_us - exposure_us) > refusals.SHARE * exposure_us:
            why, remedy = (
                f"requested {exposure_us:g} us, in steps of {step_us:g} us",
                "change the camera settings of the trajectory",
            )
            raise CaptureError("camera rejected exposure", where=self.name, why=why, remedy=remedy)
        put(self.nodes, "exposure", value)
        self._exposure_us = value * step_us

    def description(self) -> dict[str, Any]:
        """Model, serial number, exposure, all settings, factory calibration, and what depth is measured with."""
        self._require_open()
        colour, depth = self._profiles
        said = {
            "driver": "realsense",
            "model": self._info("name"),
            "serial": self.serial,
            "firmware": self._info("firmware_version"),
            "usb": self._info("usb_type_descriptor"),
            "emulated": self._emulation is not None,
            "sensor": {"width": self.settings.width, "height": self.settings.height},
            "exposure_us": self._exposure_us,
            "gain_db": self.settings.gain_db,
            "pixel_format": self.settings.pixel_format,
            "left": list(self.device.leave),
            "frames_per_s": colour.fps(),
            "factory_camera": factory_camera(colour),
            "state": self.nodes.values(),
        }
        if depth is not None:
            said["depth"] = {
                "unit_m": float(f"{self._depth.get_option(self._rs.option.depth_units):.6g}"),  # float32 there
                **factory_camera(depth),
                "camera_from_depth": rigid(depth.get_extrinsics_to(colour)).tolist(),
            }
        return said

    @property
    def nodes(self) -> OptionNodes:
        """The options of its sensors."""
        return OptionNodes(self._rs, self._colour, self._depth)

    @property
    def serial(self) -> str:
        """Its serial number."""
        return self._info("serial_number")

    @property
    def facts(self) -> dict[str, str]:
        """See `InspectedCamera`."""
        return {"firmware": self._info("firmware_version"), "link": self._info("usb_type_descriptor")}

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        """All that librealsense raises."""
        return isinstance(error, RuntimeError)

    def _connect(self) -> None:
        self._rs = rs = _library()
        every = [self._emulation.device] if self._emulation is not None else list(rs.context().query_devices())
        found = [(_info(rs, device, "serial_number"), device) for device in every]
        remedy = "check cable and camera.serial; on Linux install its udev rules"
        self._camera = only_one(found, self.device.serial, self.name, kind="RealSense camera", remedy=remedy)
        self._colour = _sensor(self._camera, rs.stream.color, self.name)
        if self.device.depth is not None:
            self._depth = _sensor(self._camera, rs.stream.depth, self.name)

    def _begin(self) -> None:
        self._connect()
        self._configure()
        self._start()

    @property
    def _colour_is_stereo(self) -> bool:
        return any(profile.stream_type() == self._rs.stream.depth for profile in self._colour.get_stream_profiles())

    def _info(self, name: str) -> str:
        return _info(self._rs, self._camera, name)

    def _configure(self) -> None:
        rs, wanted, where = self._rs, self.settings, self.name
        refusals.refuse_format(wanted, ("rgb8",), where)
        refusals.refuse_region(wanted, where)
        size = (wanted.width, wanted.height)
        fastest = 1e6 / wanted.exposure_us if "exposure_us" not in self.device.leave else np.inf
        colour, depth = _profile(self._colour, rs.stream.color, rs.format.rgb8, size, fastest, where), None
        if self.device.depth is not None:
            size = (self.device.depth.width, self.device.depth.height)
            depth = _profile(self._depth, rs.stream.depth, rs.format.z16, size, colour.fps(), where)
        self._profiles = (colour, depth)
        set_start_state(self.nodes, self.nodes.default)
        if "exposure_us" not in self.device.leave:
            self.set_exposure(wanted.exposure_us)
        refusals.require_left(self.device, "gain_db", "its gain has no unit", where)
        put_all(self.nodes, self.device.settings, where)

    def _start(self) -> None:
        rs, (colour, depth) = self._rs, self._profiles
        self._queues = (rs.frame_queue(1), None if depth is None else rs.frame_queue(1))
        for sensor, profiles in self._opening(colour, depth):
            sensor.open(profiles)
            self._sensors.append(sensor)
        for sensor in self._sensors:
            sensor.start(self._receive)
        if self._emulation is not None:
            self._emulation.start()

    def _opening(self, colour: Any, depth: Any) -> list[tuple[Any, list[Any]]]:
        """The sensors with the streams that they send; both come from one sensor in a camera without a colour sensor."""
        if depth is None:
            return [(self._colour, [colour])]
        if self._colour_is_stereo:
            return [(self._colour, [colour, depth])]
        return [(self._colour, [colour]), (self._depth, [depth])]

    def _receive(self, frame: Any) -> None:
        """Called by librealsense for every frame, in a thread of its own."""
        queue = self._queues[frame.get_profile().stream_type() == self._rs.stream.depth]
        if queue is not None:
            frame.keep()
            queue.enqueue(frame)

    def _close(self) -> None:
        sensors, self._sensors = self._sensors, []
        self._camera = self._colour = self._depth = None
        if self._emulation is not None:
            self._emulation.stop()
        for sensor in sensors:
            for end in (sensor.stop, sensor.close):
                try:
                    end()
                except RuntimeError:
                    pass  # it was not started, or has been unplugged
        self._queues = (None, None)


def _library() -> Any:
    """pyrealsense2. Raises ModuleNotFoundError: it is not installed; CaptureError: a library of the system is missing."""
    try:
        import pyrealsense2
    except ModuleNotFoundError:
        raise
    except ImportError as error:
        remedy = "install it, on Debian and Ubuntu by 'apt install libusb-1.0-0'"
        raise CaptureError("pyrealsense2 cannot be loaded", why=str(error), remedy=remedy) from None
    return pyrealsense2


def _fresh(queue: Any, patience_ms: int) -> Any:
    """The first frame that was exposed after the call."""
    queue.poll_for_frame()
    for _ in range(STALE):
        queue.wait_for_frame(patience_ms)
    return queue.wait_for_frame(patience_ms)


def _info(rs: Any, device: Any, name: str) -> str:
    key = getattr(rs.camera_info, name)
    return str(device.get_info(key)) if device.supports(key) else ""


def _sensor(device: Any, stream: Any, where: str) -> Any:
    """The sensor that sends a stream; one that sends only that is preferred."""
    found = [(len({p.stream_type() for p in sensor.get_stream_profiles()}), sensor) for sensor in device.query_sensors()]
    for _, sensor in sorted(found, key=lambda pair: pair[0]):
        if any(profile.stream_type() == stream for profile in sensor.get_stream_profiles()):
            return sensor
    remedy = "use another camera, or leave camera.depth out"
    raise CaptureError(f"camera has no {stream.name} sensor", where=where, remedy=remedy)


def _profile(sensor: Any, stream: Any, format_: Any, size: tuple[int, int], fastest: float, where: str) -> Any:
    """The mode of a size with the most pictures per second, at most `fastest`.

    Raises CaptureError: there is none; lists the sizes, or the rates of this size.
    """
    modes = [
        profile.as_video_stream_profile()
        for profile in sensor.get_stream_profiles()
        if profile.stream_type() == stream and profile.format() == format_
    ]
    fitting = [mode for mode in modes if (mode.width(), mode.height()) == size]
    if not fitting:
        offered = ", ".join(f"{width}x{height}" for width, height in sorted({(mode.width(), mode.height()) for mode in modes}))
        why, remedy = f"requested {size[0]}x{size[1]}, it offers {offered}", "set width and height to one of these"
        raise CaptureError(f"camera has no such {stream.name} mode", where=where, why=why, remedy=remedy)
    slow = [mode for mode in fitting if mode.fps() <= fastest]
    if not slow:
        why = (
            f"it sends at least {min(mode.fps() for mode in fitting)} pictures per second of this size, at most {fastest:.1f} fit"
        )
        raise CaptureError("exposure is longer than the camera can expose", where=where, why=why, remedy="expose more briefly")
    return max(slow, key=lambda mode: mode.fps())
