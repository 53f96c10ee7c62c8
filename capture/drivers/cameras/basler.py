"""Basler cameras through pylon. The only module that imports pypylon.

With `emulated=True` the same code drives the emulated camera of pylon, which shows picture files.
"""

import os
import time
from collections.abc import Collection
from typing import Any

from koala3d.capture.drivers.cameras.base import first_line, only_one
from koala3d.capture.drivers.cameras.genicam import CHANGE, Delivery, GenicamCamera
from koala3d.capture.drivers.cameras.genicam_lock import release_abandoned
from koala3d.capture.drivers.cameras.nodes import Limits
from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

READY_MS = 2000  # longest time until the camera accepts a trigger [ms]
BUFFERS = 2
"""Image buffers: only one exposure is in flight. With the default of ten, the first use of each would cost milliseconds."""
EMULATED = "8"
"""How many cameras pylon emulates; their serial numbers are 0815-0000 and so on."""
EMULATED_SENSOR = {"Width": 1920, "Height": 1080}  # sensor of the simulated rig [px]: that of an acA1920-25uc
ROW_US = 35.0
"""Time of a row of the sensor of an acA1920-25uc, in which it exposes [us]."""


class Basler(GenicamCamera):
    """One Basler camera.

    Time: `device_ticks` come from the camera: 1 ns each on USB, 8 ns on GigE without PTP. The emulation has none (0).

    Args:
        emulated: use pylon's emulated camera.
        sums: the emulated camera adds up binned columns and cannot do otherwise, as an acA1920-25uc.

    Raises:
        RigConnectionError: there is no camera, or several and no serial number, or it is busy or unplugged.
        CaptureError: a setting was rejected (requested and actual value), or no complete image arrived in time.
    """

    def __init__(
        self, settings: CameraSettings, device: Device | None = None, *, emulated: bool = False, sums: bool = False
    ) -> None:
        device = device or Device()
        if emulated:  # it sends the picture file's values as they are; `colours` encodes raw formats
            device = device.model_copy(update={"leave": ["colour_space"]})
        super().__init__(settings, device)
        self.emulated, self.sums = emulated, sums
        self._pylon: Any = None

    def feed(self, picture: str) -> None:
        """Emulation only: show a picture file in the next exposures."""
        self._require_open()
        self._stop()
        self._camera.TestImageSelector.Value = "Off"
        self._camera.ImageFileMode.Value = "On"
        self._camera.ImageFilename.Value = picture
        self._start()

    def break_next(self, count: int) -> None:
        """Emulation only: make the next `count` images incomplete."""
        self._camera.ForceFailedBufferCount.Value = count
        self._camera.ForceFailedBuffer.Execute()

    def description(self) -> dict[str, Any]:
        """Model, serial number, region, exposure, and the complete state as pylon saves it."""
        self._require_open()
        state = self._pylon.FeaturePersistence.SaveToString(self._camera.GetNodeMap())
        pairs = (line.rsplit("\t", 1) for line in state.splitlines() if "\t" in line and not line.startswith("#"))
        return {
            "driver": "basler",
            "model": self._camera.GetDeviceInfo().GetModelName(),
            "serial": self.serial,
            "emulated": self.emulated,
            "pylon": ".".join(str(part) for part in self._pylon.GetPylonVersion()),
            "firmware": self._read("DeviceFirmwareVersion", ""),
            "region": self.region.to_json(),
            "sensor": self._sensor,
            "binning_modes": self.binning_modes,
            "binning_gain": self.binning_gain,
            "exposure_us": self._exposure_us,
            "gain_db": self._gain_db,
            "black_level": self.black_level,
            "pixel_format": self._camera.PixelFormat.Value,
            "state": dict(pairs),
        }

    @property
    def name(self) -> str:
        """What messages call it."""
        return "emulated camera" if self.emulated and not self.device.serial else super().name

    @property
    def nodes(self) -> "PylonNodes":
        """Its settings."""
        return EmulatedNodes(self._camera, sums=self.sums) if self.emulated else PylonNodes(self._camera)

    @property
    def serial(self) -> str:
        """Its serial number."""
        return str(self._camera.GetDeviceInfo().GetSerialNumber())

    @property
    def facts(self) -> dict[str, str]:
        """See `InspectedCamera`."""
        return {"transport": str(self._camera.GetDeviceInfo().GetDeviceClass())}

    def _connect(self) -> None:
        if self.emulated:
            os.environ["PYLON_CAMEMU"] = EMULATED  # pylon reads it when it looks for cameras
        release_abandoned()
        from pypylon import pylon

        self._pylon = pylon
        factory = pylon.TlFactory.GetInstance()
        devices = [one for one in factory.EnumerateDevices() if (one.GetDeviceClass() == "BaslerCamEmu") == self.emulated]
        found = [(device.GetSerialNumber(), device) for device in devices]
        if self.emulated and not self.device.serial:
            found = found[:1]
        remedy = "check cable and power, and camera.serial in the rig file"
        device = only_one(found, self.device.serial, self.name, kind="Basler camera", remedy=remedy)
        self._camera = pylon.InstantCamera(factory.CreateDevice(device))
        self._camera.Open()

    def _begin(self) -> None:
        self._connect()
        self._configure()
        self._camera.MaxNumBuffer.Value = BUFFERS
        self._start()

    @staticmethod
    def _is_vendors(error: BaseException) -> bool:
        from pypylon import genicam

        return isinstance(error, genicam.GenericException)

    def _edge(self, name: str) -> int:
        """The emulation has no sensor size of its own; it gets that of the simulated rig."""
        return EMULATED_SENSOR[name] // self.settings.binning if self.emulated else super()._edge(name)

    def _expose(self) -> Delivery | str:
        camera, raise_late = self._camera, self._pylon.TimeoutHandling_ThrowException
        while (old := camera.RetrieveResult(0, self._pylon.TimeoutHandling_Return)).IsValid():
            self._number = int(old.BlockID)
            old.Release()
        camera.WaitForFrameTriggerReady(READY_MS, raise_late)
        host_time_ns = time.monotonic_ns()
        camera.ExecuteSoftwareTrigger()
        result = camera.RetrieveResult(int(1000 * self._patience_s), raise_late)
        try:
            if not result.GrabSucceeded():
                self._number = None
                return result.GetErrorDescription() or f"error {result.GetErrorCode()}"
            data, name = result.Array, camera.PixelFormat.Value
            number, ticks = int(result.BlockID), int(result.TimeStamp)
            return Delivery(data.copy(), name, number, ticks, host_time_ns, self._chunks_of(result))
        finally:
            result.Release()

    def _chunks_of(self, result: Any) -> dict[str, float]:
        """What the camera sent with a picture, as far as it can be read."""
        from pypylon import genicam

        if not (self._chunks and result.IsChunkDataAvailable()):
            return {}
        nodes = {name: result.GetChunkDataNodeMap().GetNode(f"Chunk{name}") for name in self._chunks}
        return {name: float(node.Value) for name, node in nodes.items() if node is not None and genicam.IsReadable(node)}

    def _start(self) -> None:
        super()._start()
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def _stop(self) -> None:
        self._camera.StopGrabbing()

    @property
    def _is_unplugged(self) -> bool:
        return bool(self._camera.IsCameraDeviceRemoved())

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.Close()  # also stops grabbing; may be called when not open


class PylonNodes:
    """`capture.drivers.cameras.nodes.Nodes` of an opened camera."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera

    def has(self, name: str) -> bool:
        """Commands, which may only be written, count as present."""
        from pypylon import genicam

        node = self._camera.GetNodeMap().GetNode(name)
        return node is not None and bool(genicam.IsReadable(node) or genicam.IsWritable(node))

    def read(self, name: str) -> Any:
        """Its value."""
        return getattr(self._camera, name).Value

    def symbolics(self, name: str) -> Collection[str]:
        """Names of an enumeration's values."""
        return tuple(getattr(getattr(self._camera, name), "Symbolics", ()))

    def limits(self, name: str) -> Limits:
        """What a number may be now."""
        node = getattr(self._camera, name)
        stepped = getattr(node, "HasInc", lambda: True)()  # a whole number always has one
        return Limits(node.Min, node.Max, node.Inc if stepped else 0.0)

    def write(self, name: str, value: Any) -> None:
        """A command takes None."""
        from pypylon import genicam

        node = getattr(self._camera, name)
        try:
            if value is None:
                node.Execute()
            else:
                node.Value = value
        except (genicam.GenericException, TypeError) as error:
            limits = f", possible: {node.Min} to {node.Max}" if hasattr(node, "Min") else ""
            why = f"requested {value}: {first_line(error)}{limits}"
            raise CaptureError(f"camera rejected {name}", why=why, remedy=CHANGE) from None


class EmulatedNodes(PylonNodes):
    """The emulated camera, with exposure times in whole rows; with `sums`, binned columns are added up and rows averaged."""

    def __init__(self, camera: Any, *, sums: bool = False) -> None:
        super().__init__(camera)
        self._fixed = {"BinningHorizontalMode": "Sum", "BinningVerticalMode": "Average"} if sums else {}

    def read(self, name: str) -> Any:
        """Its value."""
        return self._fixed.get(name) or super().read(name)

    def limits(self, name: str) -> Limits:
        """What a number may be now."""
        found = super().limits(name)
        return Limits(ROW_US, found.high, ROW_US) if name == "ExposureTime" else found

    def write(self, name: str, value: Any) -> None:
        """As the camera does, an exposure time that is not whole rows becomes the nearest that is."""
        if name in self._fixed:
            raise CaptureError(
                f"camera rejected {name}", why=f"requested {value}; it is always {self._fixed[name]}", remedy=CHANGE
            )
        if name != "ExposureTime":
            return super().write(name, value)
        if value < ROW_US:
            raise CaptureError(f"camera rejected {name}", why=f"requested {value:g}, possible from {ROW_US:g}", remedy=CHANGE)
        super().write(name, Limits(ROW_US, super().limits(name).high, ROW_US).nearest(value))


def serial_of(number: int) -> str:
    """Serial number of the emulated camera with a number, from 0; empty for the first one, which is then called the camera."""
    return f"0815-{number:04d}" if number else ""
