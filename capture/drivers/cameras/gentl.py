"""Any GenICam camera (GigE Vision, USB3 Vision, CoaXPress) through harvesters and the GenTL producer of its maker.

A producer is a library with the ending .cti that each maker ships; `camera.source` names it. Only this module imports harvesters.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from koala3d.capture.drivers.cameras import refusals
from koala3d.capture.drivers.cameras.gentl_nodes import GenTlNodes, first_line, is_vendors, tried
from koala3d.capture.drivers.cameras.nodes import first, put, put_all
from koala3d.capture.drivers.cameras.pixels import choose_format, colours
from koala3d.capture.drivers.cameras.start_state import load_default, set_colour_space, set_plain
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.datasets.imaging.region import Region

TRANSFER_S = 3.0  # longest time for an image after its exposure [s]
TRIES = 4  # attempts to get a complete image before the grab fails
BUFFERS = 3
PATHS = "GENICAM_GENTL64_PATH"  # where producers are installed, by the standard's own variable
AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
GAINS = ("Gain", "GainAbs")


class GenTlCamera:
    """One GenICam camera with constant exposure and gain, triggered by software.

    Lifecycle: the constructor does no I/O. Entering loads the producer, opens the camera, writes every setting and reads it back;
    on any failure all is closed again.

    What a camera lacks must be in `device.leave`. Without a trigger (`leave: [trigger]`) it runs freely, and what it has sent
    before the request is thrown away.

    Time: `device_ticks` are the producer's; 0 where it has none.

    Raises:
        RigConnectionError: the producer cannot be loaded, there is no camera, or several and no serial number, or it is busy.
        CaptureError: a setting was rejected (requested and actual value), or no complete image arrived in time.
    """

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        self.settings, self.device = settings, device
        self._harvester: Any = None
        self._acquirer: Any = None
        self._info: dict[str, str] = {}

    def __enter__(self) -> Self:
        try:
            self._open()
            self._configure()
            self._acquirer.num_buffers = max(BUFFERS, self._acquirer.min_num_buffers)
            self._acquirer.start()
        except BaseException as error:
            self._close()
            if is_vendors(error):
                remedy = "close other programs that use it, or plug it in again"
                raise RigConnectionError(
                    "camera could not be set up", where=self._name(), why=first_line(error), remedy=remedy
                ) from None
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._close()

    def grab(self) -> Image:
        """Trigger one exposure and wait for it; retries incomplete images up to `TRIES` times."""
        self._require_open()
        late = f"nothing within {self._patience_s:.1f} s"
        why = ""
        for _ in range(TRIES):
            try:
                image = self._try()
            except Exception as error:
                if not is_vendors(error):
                    raise
                why = late if type(error).__name__ == "TimeoutException" else first_line(error)
                remedy = "check its cable and resume with --resume"
                raise RigConnectionError("camera gave no image", where=self._name(), why=why, remedy=remedy) from None
            if image is not None:
                return image
        why, remedy = "packets were lost", "check cable and bandwidth, then resume with --resume"
        raise CaptureError(f"camera gave {TRIES} damaged images in a row", where=self._name(), why=why, remedy=remedy)

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises CaptureError: the camera rejects it, or has none."""
        self._require_open()
        name = first(self._nodes, EXPOSURES)
        if name is None or "exposure_us" in self.device.leave:
            why, remedy = (
                "it has no ExposureTime, or camera.leave names it",
                "list exposure_us in camera.leave, and take no brackets",
            )
            raise CaptureError("camera takes no exposure time", where=self._name(), why=why, remedy=remedy)
        put(self._nodes, name, exposure_us, tolerance=refusals.SHARE * exposure_us + 1)

    @property
    def region(self) -> Region:
        """The region of the sensor in the images, as read back."""
        read = self._read
        return Region(read("Width"), read("Height"), read("OffsetX", 0), read("OffsetY", 0), read("BinningHorizontal", 1))

    def description(self) -> dict[str, Any]:
        """Model, serial number, region, exposure, and all settings that can be read."""
        self._require_open()
        region, nodes = self.region, self._nodes
        exposure, gain = first(nodes, EXPOSURES), first(nodes, GAINS)
        return {
            "driver": "genicam",
            "model": " ".join(self._info[key] for key in ("vendor", "model")).strip(),
            "serial": self._info["serial_number"],
            "firmware": str(self._read("DeviceFirmwareVersion", "")),
            "producer": self._info["producer"],
            "region": region.to_json(),
            "sensor": {"width": self._edge("Width") * region.binning, "height": self._edge("Height") * region.binning},
            "exposure_us": float(nodes.read(exposure)) if exposure else self.settings.exposure_us,
            "gain_db": float(nodes.read(gain)) if gain else self.settings.gain_db,
            "pixel_format": nodes.read("PixelFormat"),
            "left": list(self.device.leave),
            "state": nodes.values(),
        }

    def _open(self) -> None:
        from harvesters.core import Harvester

        self._harvester = Harvester()
        for path in _producers(self.device.source):
            self._harvester.add_file(str(path), check_existence=True)
        self._harvester.update()
        listed = [_facts(info) for info in self._harvester.device_info_list]
        chosen = [one for one in listed if self.device.serial in ("", one["serial_number"])]
        found = ", ".join(f"{one['model']} {one['serial_number'] or one['id_']}" for one in listed)
        if not chosen:
            remedy = "check cable and power, and camera.serial in the rig file"
            why = f"the producer finds {found or 'none, or it cannot be loaded'}"
            raise RigConnectionError("no GenICam camera was found", where=self._name(), why=why, remedy=remedy)
        if len(chosen) > 1:
            remedy = "write the serial number into the rig file"
            raise RigConnectionError("several GenICam cameras are connected", where=self._name(), why=found, remedy=remedy)
        self._info = chosen[0]
        with _ctrl_c_stays():
            self._acquirer = self._harvester.create({"id_": self._info["id_"]})

    @property
    def _nodes(self) -> "GenTlNodes":
        return GenTlNodes(self._acquirer.remote_device.node_map)

    def _configure(self) -> None:
        wanted, nodes, leave, where = self.settings, self._nodes, self.device.leave, self._name()
        if "factory_settings" not in leave:
            if not nodes.has("UserSetLoad"):
                refusals.require_left(self.device, "factory_settings", "it has no UserSetLoad", where)
            load_default(nodes)
        set_plain(nodes)
        for automatic in AUTOMATICS:
            if nodes.has(automatic):
                put(nodes, automatic, "Off")
        put(nodes, "PixelFormat", choose_format(wanted.pixel_format, nodes.symbolics("PixelFormat"), where=where))
        if "colour_space" not in leave:
            set_colour_space(nodes, encoded=wanted.pixel_format == "rgb8")
        self._set_region()
        if "exposure_us" not in leave:
            self.set_exposure(wanted.exposure_us)
        if "gain_db" not in leave:
            if (gain := first(nodes, GAINS)) is None:
                refusals.require_left(self.device, "gain_db", "it has no Gain", where)
            else:
                put(nodes, gain, wanted.gain_db, tolerance=0.05)
        if "trigger" not in leave:
            if not nodes.has("TriggerMode"):
                refusals.require_left(self.device, "trigger", "it has no TriggerMode", where)
            for name, value in (("Selector", "FrameStart"), ("Mode", "On"), ("Source", "Software")):
                put(nodes, f"Trigger{name}", value)
        put_all(nodes, self.device.settings, where)

    def _set_region(self) -> None:
        """Binning, then size and place of the region, centred where the trajectory does not say."""
        wanted, nodes = self.settings, self._nodes
        if wanted.binning > 1 or nodes.has("BinningHorizontal"):
            for name in ("BinningHorizontal", "BinningVertical"):
                put(nodes, name, wanted.binning)
        for name in ("OffsetX", "OffsetY"):
            if nodes.has(name):
                put(nodes, name, 0)
        for name, edge, offset, place in (
            ("Width", wanted.width, wanted.offset_x, "OffsetX"),
            ("Height", wanted.height, wanted.offset_y, "OffsetY"),
        ):
            available, step = self._edge(name), self._step(place)
            put(nodes, name, edge)
            if nodes.has(place):
                put(nodes, place, offset if offset is not None else max(available - edge, 0) // 2 // step * step)
            elif offset:
                why, remedy = f"offset {offset} was requested", "remove the offsets"
                raise CaptureError(f"camera has no {place}", where=self._name(), why=why, remedy=remedy)

    def _edge(self, name: str) -> int:
        """Width or height of the sensor [binned px], as far as the camera says it."""
        return int(self._read(f"{name}Max", self._read(name)))

    def _step(self, name: str) -> int:
        return int(self._nodes.node(name).inc) if self._nodes.has(name) else 1

    def _read(self, name: str, default: Any = None) -> Any:
        return self._nodes.read(name) if default is None or self._nodes.has(name) else default

    @property
    def _patience_s(self) -> float:
        name = first(self._nodes, EXPOSURES)
        return TRANSFER_S + (1e-6 * float(self._nodes.read(name)) if name else 0.0)

    def _try(self) -> Image | None:
        nodes, host_time_ns = self._nodes, time.monotonic_ns()
        if "trigger" in self.device.leave:
            for _ in range(self._acquirer.num_buffers + 1):  # those that are full, and the one that is being exposed
                self._acquirer.fetch(timeout=self._patience_s).queue()
        else:
            nodes.write("TriggerSoftware", None)
        with self._acquirer.fetch(timeout=self._patience_s) as buffer:
            if not buffer.payload.components:
                return None
            part = buffer.payload.components[0]
            channels = round(part.num_components_per_pixel)
            if part.data.size != part.height * part.width * channels:
                return None
            shape = (part.height, part.width, channels) if channels > 1 else (part.height, part.width)
            data, name, ticks = np.array(part.data).reshape(shape), str(part.data_format), _ticks(buffer)
        exposure, gain = first(nodes, EXPOSURES), first(nodes, GAINS)
        exposure_us = float(nodes.read(exposure)) if exposure else self.settings.exposure_us
        gain_db = float(nodes.read(gain)) if gain else self.settings.gain_db
        raw = data.astype(np.uint16) if name.endswith("12") else None
        return Image(colours(data, name), exposure_us, gain_db, ticks, host_time_ns, raw)

    def _require_open(self) -> None:
        if self._acquirer is None:
            raise CaptureError("camera is closed", where=self._name(), remedy="open it first")

    def _name(self) -> str:
        return f"camera {self.device.serial}" if self.device.serial else "camera"

    def _close(self) -> None:
        acquirer, harvester = self._acquirer, self._harvester
        self._acquirer, self._harvester = None, None
        if acquirer is not None:
            acquirer.destroy()  # also stops it
        if harvester is not None:
            harvester.reset()


@contextmanager
def opened(device: Device) -> Iterator[tuple[GenTlNodes, str]]:
    """Open a camera only to look at it: its settings and its serial number. Raises RigConnectionError as the driver does."""
    driver = GenTlCamera(CameraSettings(), device)
    try:
        driver._open()
        yield driver._nodes, driver._info["serial_number"]
    finally:
        driver._close()


@contextmanager
def _ctrl_c_stays() -> Iterator[None]:
    """Leave Ctrl-C as it was. Harvesters takes it to close its camera, and for good: it would no longer stop the arm."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():  # others may not, and harvesters does not there
            signal.signal(signal.SIGINT, before)


def _producers(source: str) -> list[Path]:
    """The named producer, or all in the folders of the environment. Raises RigConnectionError: there is none."""
    if source:
        if not Path(source).is_file():
            raise RigConnectionError(
                "no such GenTL producer", where=source, remedy="camera.source names a file with the ending .cti"
            )
        return [Path(source)]
    folders = [Path(part) for part in os.environ.get(PATHS, "").split(os.pathsep) if part]
    found = [path for folder in folders for path in sorted(folder.glob("*.cti"))]
    if not found:
        remedy = "install the software of the camera's maker, and name its .cti file in camera.source"
        raise RigConnectionError("no GenTL producer", why=f"camera.source is empty, and {PATHS} names none", remedy=remedy)
    return found


def _facts(info: Any) -> dict[str, str]:
    """What a producer says about a camera; it need not say all."""
    found = {key: str(tried(info, key) or "") for key in ("id_", "vendor", "model", "serial_number", "version")}
    return {**found, "producer": str(tried(info.parent.parent, "path_name") or "")}


def _ticks(buffer: Any) -> int:
    return int(tried(buffer, "timestamp_ns") or tried(buffer, "timestamp") or 0)
