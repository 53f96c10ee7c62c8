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

from koala3d.capture.drivers.cameras.base import only_one
from koala3d.capture.drivers.cameras.genicam import Delivery, GenicamCamera
from koala3d.capture.drivers.cameras.gentl_nodes import GenTlNodes, is_vendors, tried
from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

BUFFERS = 3
SOON_S = 1e-3  # how long an old picture is waited for; harvesters takes 0 for forever
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
            "black_level": self.black_level,
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

    @property
    def facts(self) -> dict[str, str]:
        """See `InspectedCamera`."""
        return {"transport": self._info["tl_type"]}

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
        self._start()

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        return is_vendors(error)

    def _expose(self) -> Delivery | str:
        host_time_ns = time.monotonic_ns()
        if "trigger" in self.device.leave:
            for _ in range(self._camera.num_buffers + 1):  # those that are full, and the one that is being exposed
                self._camera.fetch(timeout=self._patience_s).queue()
        else:
            self._drain()
            self.nodes.write("TriggerSoftware", None)
        with self._camera.fetch(timeout=self._patience_s) as buffer:
            part = buffer.payload.components[0] if buffer.payload.components else None
            channels = 0 if part is None else round(part.num_components_per_pixel)
            if part is None or part.data.size != part.height * part.width * channels:
                self._number = None
                return "packets were lost"
            shape = (part.height, part.width, channels) if channels > 1 else (part.height, part.width)
            data, name = np.array(part.data).reshape(shape), str(part.data_format)
            chunks = {one: float(self.nodes.read(f"Chunk{one}")) for one in self._chunks if self.nodes.has(f"Chunk{one}")}
            return Delivery(data, name, _number(buffer), _ticks(buffer), host_time_ns, chunks)

    def _drain(self) -> None:
        """Throw away the pictures that are there."""
        while (old := self._camera.try_fetch(timeout=SOON_S)) is not None:
            self._number = _number(old)
            old.queue()

    def _start(self) -> None:
        super()._start()
        self._camera.start()

    def _stop(self) -> None:
        self._camera.stop()

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
    found = {key: str(tried(info, key) or "") for key in ("id_", "vendor", "model", "serial_number", "version", "tl_type")}
    return {**found, "producer": str(tried(info.parent.parent, "path_name") or "")}


def _number(buffer: Any) -> int | None:
    found = tried(buffer, "frame_id")
    return None if found is None else int(found)


def _ticks(buffer: Any) -> int:
    return int(tried(buffer, "timestamp_ns") or tried(buffer, "timestamp") or 0)
