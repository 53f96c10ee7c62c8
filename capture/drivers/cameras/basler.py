"""Basler cameras through pylon. The only module that imports pypylon.

With `emulated=True` the same code drives the emulated camera of pylon, which shows picture files.
"""

import os
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Self

from koala3d.capture.drivers.cameras.genicam_lock import release_abandoned
from koala3d.capture.drivers.cameras.nodes import put_all
from koala3d.capture.drivers.cameras.pixels import choose_format, colours
from koala3d.capture.drivers.cameras.start_state import load_default, set_colour_space, set_plain
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.datasets.imaging.region import Region

TRIES = 4  # attempts to get an undamaged image before the grab fails
READY_MS = 2000  # longest time until the camera accepts a trigger [ms]
TRANSFER_MS = 3000  # longest time for an image after its exposure [ms]
BUFFERS = 2
"""Image buffers: only one exposure is in flight. With the default of ten, the first use of each would cost milliseconds."""
AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
"""Automatic functions, set to Off where they exist: nothing may change from picture to picture."""

EMULATED = "8"
"""How many cameras pylon emulates; their serial numbers are 0815-0000 and so on."""
EMULATED_SENSOR = {"Width": 1920, "Height": 1080}  # sensor of the simulated rig [px]: that of an acA1920-25uc
CHANGE = "change the camera settings of the trajectory"


class Basler:
    """One Basler camera with constant exposure and gain, triggered by software.

    Lifecycle: the constructor does no I/O. Entering opens the camera, writes every setting, reads each back and compares.
    On any failure the camera is closed again. Use as a context manager. `own` are more settings by pylon's names, written last.

    Time: `device_ticks` come from the camera: 1 ns each on USB, 8 ns on GigE without PTP. The emulation has none (0).

    Raises:
        RigConnectionError: there is no camera, or several and no serial number, or it is busy or unplugged.
        CaptureError: a setting was rejected (requested and actual value), or no complete image arrived in time.
    """

    def __init__(
        self,
        settings: CameraSettings,
        *,
        serial: str = "",
        emulated: bool = False,
        own: Mapping[str, bool | int | float | str] | None = None,
    ) -> None:
        self.settings, self.serial, self.emulated, self.own = settings, serial, emulated, dict(own or {})
        self._camera: Any = None
        self._pylon: Any = None

    def __enter__(self) -> Self:
        if self.emulated:
            os.environ["PYLON_CAMEMU"] = EMULATED  # pylon reads it when it looks for cameras
        release_abandoned()
        from pypylon import pylon

        self._pylon = pylon
        self._camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateDevice(self._find()))
        try:
            self._camera.Open()
            self._configure()
            self._camera.MaxNumBuffer.Value = BUFFERS
            self._camera.StartGrabbing(pylon.GrabStrategy_OneByOne)
        except pylon.GenericException as error:
            self._close()
            why, remedy = _first_line(error), "close other programs that use it, or plug it in again"
            raise RigConnectionError("camera could not be set up", where=self._name(), why=why, remedy=remedy) from None
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._close()

    def grab(self) -> Image:
        """Trigger one exposure and wait for it; retries damaged images up to `TRIES` times."""
        self._require_open()
        reasons = []
        try:
            for _ in range(TRIES):
                image, reason = self._try()
                if image is not None:
                    return image
                reasons.append(reason)
        except self._pylon.GenericException as error:
            if self._camera.IsCameraDeviceRemoved():
                remedy = "plug it in and resume with --resume"
                raise RigConnectionError("camera was unplugged", where=self._name(), remedy=remedy) from None
            raise self._fault("camera gave no image", _first_line(error), "check its cable and resume with --resume") from None
        remedy = "check cable and bandwidth, then resume with --resume"
        raise self._fault(f"camera gave {TRIES} damaged images in a row", reasons[-1], remedy)

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises CaptureError: the camera rejects it."""
        self._require_open()
        self._set(self._exposure_name, exposure_us, tolerance=0.01 * exposure_us + 1)

    def feed(self, picture: str) -> None:
        """Emulation only: show a picture file in the next exposures."""
        self._require_open()
        self._camera.StopGrabbing()
        self._camera.TestImageSelector.Value = "Off"
        self._camera.ImageFileMode.Value = "On"
        self._camera.ImageFilename.Value = picture
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def break_next(self, count: int) -> None:
        """Emulation only: make the next `count` images incomplete."""
        self._camera.ForceFailedBufferCount.Value = count
        self._camera.ForceFailedBuffer.Execute()

    @property
    def region(self) -> Region:
        """The region of the sensor in the images, as read back."""
        camera = self._camera
        binning = _value(camera, "BinningHorizontal", default=1)
        return Region(camera.Width.Value, camera.Height.Value, camera.OffsetX.Value, camera.OffsetY.Value, binning)

    def description(self) -> dict[str, Any]:
        """Model, serial number, region, exposure, and the complete state as pylon saves it."""
        self._require_open()
        info, binning = self._camera.GetDeviceInfo(), self.region.binning
        state = self._pylon.FeaturePersistence.SaveToString(self._camera.GetNodeMap())
        pairs = (line.rsplit("\t", 1) for line in state.splitlines() if "\t" in line and not line.startswith("#"))
        return {
            "driver": "basler",
            "model": info.GetModelName(),
            "serial": info.GetSerialNumber(),
            "emulated": self.emulated,
            "pylon": ".".join(str(part) for part in self._pylon.GetPylonVersion()),
            "firmware": _value(self._camera, "DeviceFirmwareVersion", default=""),
            "region": self.region.to_json(),
            "sensor": {"width": self._sensor_edge("Width") * binning, "height": self._sensor_edge("Height") * binning},
            "exposure_us": self._exposure.Value,
            "gain_db": self._gain_db(),
            "pixel_format": self._camera.PixelFormat.Value,
            "state": dict(pairs),
        }

    def _require_open(self) -> None:
        if self._camera is None:
            raise self._fault("camera is closed", "", "open it first")

    def _find(self) -> Any:
        every = self._pylon.TlFactory.GetInstance().EnumerateDevices()
        devices = [device for device in every if (device.GetDeviceClass() == "BaslerCamEmu") == self.emulated]
        serials = [device.GetSerialNumber() for device in devices]
        if self.serial:
            devices = [device for device in devices if device.GetSerialNumber() == self.serial]
        if not devices:
            connected = f"connected: {', '.join(serials) or 'none'}"
            remedy = "check cable and power, and camera.serial in the rig file"
            raise RigConnectionError("no Basler camera was found", where=self._name(), why=connected, remedy=remedy)
        if len(devices) > 1 and not self.emulated:
            remedy = "write the serial number into the rig file"
            raise RigConnectionError("several Basler cameras are connected", why=", ".join(serials), remedy=remedy)
        return devices[0]

    def _configure(self) -> None:
        camera, wanted, nodes = self._camera, self.settings, PylonNodes(self._camera)
        load_default(nodes)
        set_plain(nodes)
        for automatic in AUTOMATICS:
            if _has(camera, automatic):
                self._set(automatic, "Off")
        self._set("PixelFormat", choose_format(wanted.pixel_format, camera.PixelFormat.Symbolics, where=self._name()))
        if not self.emulated:  # the emulation sends the picture file's values as they are; `colours` encodes raw formats
            set_colour_space(nodes, encoded=wanted.pixel_format == "rgb8")
        if wanted.binning > 1 or _has(camera, "BinningHorizontal"):
            self._set("BinningHorizontal", wanted.binning)
            self._set("BinningVertical", wanted.binning)
        for name, value in (("OffsetX", 0), ("OffsetY", 0), ("Width", wanted.width), ("Height", wanted.height)):
            self._set(name, value)
        self._set("OffsetX", _centred(wanted.offset_x, self._sensor_edge("Width"), wanted.width, camera.OffsetX.Inc))
        self._set("OffsetY", _centred(wanted.offset_y, self._sensor_edge("Height"), wanted.height, camera.OffsetY.Inc))
        self.set_exposure(wanted.exposure_us)
        self._set("Gain", wanted.gain_db, tolerance=0.05)
        for name, value in (("Selector", "FrameStart"), ("Mode", "On"), ("Source", "Software")):
            self._set(f"Trigger{name}", value)
        put_all(nodes, self.own, self._name())

    def _sensor_edge(self, name: str) -> int:
        """Binned width or height of the sensor [px]. The emulation has no fixed sensor size; we use that of the simulated rig."""
        if self.emulated:
            return EMULATED_SENSOR[name] // self.settings.binning
        return int(getattr(self._camera, f"{name}Max").Value)

    @property
    def _exposure_name(self) -> str:
        return "ExposureTime" if _has(self._camera, "ExposureTime") else "ExposureTimeAbs"

    @property
    def _exposure(self) -> Any:
        return getattr(self._camera, self._exposure_name)

    def _gain_db(self) -> float:
        return float(self._camera.Gain.Value)

    def _set(self, name: str, value: Any, *, tolerance: float = 0.0) -> None:
        """Write one setting and read it back."""
        if not _has(self._camera, name):
            raise self._fault(f"camera has no setting {name}", f"{value} was requested")
        node = getattr(self._camera, name)
        try:
            node.Value = value
        except self._pylon.GenericException:
            limits = f", possible: {node.Min} to {node.Max}" if hasattr(node, "Min") else ""
            why = f"requested {value}, it stays at {node.Value}{limits}"
            raise self._fault(f"camera rejected {name}", why, CHANGE) from None
        actual = node.Value
        if actual != value and not (tolerance and abs(actual - value) <= tolerance):
            raise self._fault(f"camera changed {name}", f"requested {value}, actual {actual}", CHANGE)

    def _try(self) -> tuple[Image | None, str]:
        camera, raise_late = self._camera, self._pylon.TimeoutHandling_ThrowException
        camera.WaitForFrameTriggerReady(READY_MS, raise_late)
        host_time_ns = time.monotonic_ns()
        camera.ExecuteSoftwareTrigger()
        result = camera.RetrieveResult(TRANSFER_MS + int(self._exposure.Value / 1000), raise_late)
        try:
            if not result.GrabSucceeded():
                return None, result.GetErrorDescription() or f"error {result.GetErrorCode()}"
            data, name = result.Array, camera.PixelFormat.Value
            raw = data.copy() if name.endswith("12") else None
            taken = (float(self._exposure.Value), self._gain_db(), int(result.TimeStamp), host_time_ns)
            return Image(colours(data, name), *taken, raw), ""
        finally:
            result.Release()

    def _fault(self, what: str, why: str, remedy: str = "") -> CaptureError:
        return CaptureError(what, where=self._name(), why=why, remedy=remedy)

    def _name(self) -> str:
        return f"camera {self.serial}" if self.serial else "emulated camera" if self.emulated else "camera"

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.Close()  # also stops grabbing; may be called when not open


class PylonNodes:
    """`capture.drivers.cameras.nodes.Nodes` of an opened camera."""

    def __init__(self, camera: Any) -> None:
        self._camera = camera

    def has(self, name: str) -> bool:
        """Commands count as readable."""
        return _has(self._camera, name)

    def read(self, name: str) -> Any:
        """Its value."""
        return getattr(self._camera, name).Value

    def symbolics(self, name: str) -> Collection[str]:
        """Names of an enumeration's values."""
        return tuple(getattr(getattr(self._camera, name), "Symbolics", ()))

    def write(self, name: str, value: Any) -> None:
        """A command takes None."""
        from pypylon import genicam

        try:
            if value is None:
                getattr(self._camera, name).Execute()
            else:
                getattr(self._camera, name).Value = value
        except (genicam.GenericException, TypeError) as error:
            raise CaptureError(f"camera rejected {name}", why=f"requested {value}: {_first_line(error)}", remedy=CHANGE) from None


def serial_of(number: int) -> str:
    """Serial number of the emulated camera with a number, from 0; empty for the first one, which is then called the camera."""
    return f"0815-{number:04d}" if number else ""


@contextmanager
def opened(serial: str, *, emulated: bool = False) -> Iterator[tuple[PylonNodes, str]]:
    """Open a camera only to look at it: its settings and its serial number.

    Raises RigConnectionError: there is none, or several and no serial number, or another program uses it.
    """
    if emulated:
        os.environ["PYLON_CAMEMU"] = EMULATED
    release_abandoned()
    from pypylon import pylon

    driver = Basler(CameraSettings(), serial=serial, emulated=emulated)
    driver._pylon = pylon
    camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateDevice(driver._find()))
    try:
        camera.Open()
    except pylon.GenericException as error:
        remedy = "close other programs that use it, or plug it in again"
        raise RigConnectionError("camera cannot be opened", where=driver._name(), why=_first_line(error), remedy=remedy) from None
    try:
        yield PylonNodes(camera), str(camera.GetDeviceInfo().GetSerialNumber())
    finally:
        camera.Close()


def _has(camera: Any, name: str) -> bool:
    """Whether the camera has a setting that can be read now."""
    from pypylon import genicam

    node = camera.GetNodeMap().GetNode(name)
    return node is not None and bool(genicam.IsReadable(node))


def _value(camera: Any, name: str, *, default: Any) -> Any:
    return getattr(camera, name).Value if _has(camera, name) else default


def _centred(offset: int | None, available: int, wanted: int, increment: int) -> int:
    """The requested offset, or the one that centres the region on the grid of the camera [binned px]."""
    return offset if offset is not None else max(available - wanted, 0) // 2 // increment * increment


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
