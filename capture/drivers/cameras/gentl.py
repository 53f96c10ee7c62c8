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
from typing import Any

import numpy as np

from koala3d.capture.drivers.cameras.base import first_line, only_one
from koala3d.capture.drivers.cameras.genicam import GenicamCamera
from koala3d.capture.drivers.cameras.gentl_nodes import GenTlNodes, is_vendors, tried
from koala3d.capture.drivers.cameras.pixels import colours
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

TRANSFER_S = 3.0  # longest time for an image after its exposure [s]
TRIES = 4  # attempts to get a complete image before the grab fails
BUFFERS = 3
PATHS = "GENICAM_GENTL64_PATH"  # where producers are installed, by the standard's own variable


class GenTlCamera(GenicamCamera):
    """One GenICam camera behind the producer of its maker.

    Without a trigger (`leave: [trigger]`) it runs freely, and what it has sent before the request is thrown away.

    Time: `device_ticks` are the producer's; 0 where it has none.

    Raises:
        RigConnectionError: the producer cannot be loaded, there is no camera, or several and no serial number, or it is busy.
        CaptureError: a setting was rejected (requested and actual value), or no complete image arrived in time.
    """

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        super().__init__(settings, device)
        self._harvester: Any = None
        self._info: dict[str, str] = {}

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
                raise RigConnectionError("camera gave no image", where=self.name, why=why, remedy=remedy) from None
            if image is not None:
                return image
        why, remedy = "packets were lost", "check cable and bandwidth, then resume with --resume"
        raise CaptureError(f"camera gave {TRIES} damaged images in a row", where=self.name, why=why, remedy=remedy)

    def description(self) -> dict[str, Any]:
        """Model, serial number, region, exposure, and all settings that can be read."""
        self._require_open()
        return {
            "driver": "genicam",
            "model": " ".join(self._info[key] for key in ("vendor", "model")).strip(),
            "serial": self.serial,
            "firmware": str(self._read("DeviceFirmwareVersion", "")),
            "producer": self._info["producer"],
            "region": self.region.to_json(),
            "sensor": self._sensor,
            "binning_modes": self.binning_modes,
            "binning_gain": self.binning_gain,
            "exposure_us": self._exposure_us,
            "gain_db": self._gain_db,
            "pixel_format": self.nodes.read("PixelFormat"),
            "left": list(self.device.leave),
            "state": self.nodes.values(),
        }

    @property
    def nodes(self) -> GenTlNodes:
        """Its settings."""
        return GenTlNodes(self._camera.remote_device.node_map)

    @property
    def serial(self) -> str:
        """Its serial number."""
        return self._info["serial_number"]

    def _connect(self) -> None:
        from harvesters.core import Harvester

        self._harvester = Harvester()
        for path in _producers(self.device.source):
            self._harvester.add_file(str(path), check_existence=True)
        self._harvester.update()
        listed = [_facts(info) for info in self._harvester.device_info_list]
        words = ", ".join(f"{one['model']} {one['serial_number'] or one['id_']}" for one in listed)
        found = [(one["serial_number"], one) for one in listed]
        remedy = "check cable and power, camera.serial in the rig file, and whether the producer can be loaded"
        self._info = only_one(found, self.device.serial, self.name, kind="GenICam camera", words=words, remedy=remedy)
        with _ctrl_c_stays():
            self._camera = self._harvester.create({"id_": self._info["id_"]})

    def _begin(self) -> None:
        self._connect()
        self._configure()
        self._camera.num_buffers = max(BUFFERS, self._camera.min_num_buffers)
        self._camera.start()

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        return is_vendors(error)

    @property
    def _patience_s(self) -> float:
        return TRANSFER_S + 1e-6 * self._exposure_us

    def _try(self) -> Image | None:
        host_time_ns = time.monotonic_ns()
        if "trigger" in self.device.leave:
            for _ in range(self._camera.num_buffers + 1):  # those that are full, and the one that is being exposed
                self._camera.fetch(timeout=self._patience_s).queue()
        else:
            self.nodes.write("TriggerSoftware", None)
        with self._camera.fetch(timeout=self._patience_s) as buffer:
            if not buffer.payload.components:
                return None
            part = buffer.payload.components[0]
            channels = round(part.num_components_per_pixel)
            if part.data.size != part.height * part.width * channels:
                return None
            shape = (part.height, part.width, channels) if channels > 1 else (part.height, part.width)
            data, name, ticks = np.array(part.data).reshape(shape), str(part.data_format), _ticks(buffer)
        raw = data.astype(np.uint16) if name.endswith("12") else None
        return Image(colours(data, name), self._exposure_us, self._gain_db, ticks, host_time_ns, raw)

    def _close(self) -> None:
        acquirer, harvester = self._camera, self._harvester
        self._camera, self._harvester = None, None
        if acquirer is not None:
            acquirer.destroy()  # also stops it
        if harvester is not None:
            harvester.reset()


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
