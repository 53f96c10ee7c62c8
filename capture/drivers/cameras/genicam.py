"""Cameras that follow the GenICam standard: one way to set them up, over whichever library reads their settings."""

import math
import time
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from koala3d.capture.drivers.cameras import refusals
from koala3d.capture.drivers.cameras.base import CameraDriver, first_line
from koala3d.capture.drivers.cameras.nodes import Limits, Nodes, first, put, put_all
from koala3d.capture.drivers.cameras.pixels import choose_format, colours
from koala3d.capture.drivers.cameras.start_state import load_default, set_colour_space, set_pedestal, set_plain
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.measurements import Image, Pixels
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings
from koala3d.datasets.imaging.region import Region

AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
"""Automatic functions, set to Off where they exist: nothing may change from picture to picture."""
EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
GAINS = ("Gain", "GainAbs")
CHUNKS = ("ExposureTime", "Gain", "Timestamp")
"""What a camera says of each picture, if it can, by its names in `ChunkSelector`; the value is in Chunk and the name."""
LATCHES = {"TimestampLatch": "TimestampLatchValue", "GevTimestampControlLatch": "GevTimestampValue"}
"""Commands that make a camera note the time of its clock, and the setting that then holds it [ticks]."""
FREQUENCY = "GevTimestampTickFrequency"
"""Ticks per second of a GigE camera's clock; those of USB cameras are nanoseconds."""
TRANSFER_S = 3.0  # longest time for an image after its exposure [s]
TRIES = 4  # attempts to get an undamaged image before the grab fails
AVERAGE, SUM = "Average", "Sum"
BINNING = {"horizontal": "BinningHorizontal", "vertical": "BinningVertical"}
UNSAID = {"acA1920-25uc": {"horizontal": "Sum", "vertical": "Average"}}
"""What binning does in cameras that have no setting for it, by model (Basler, AW001234)."""
TRIGGER = {"TriggerSelector": "FrameStart", "TriggerMode": "On", "TriggerSource": "Software"}
ROUNDED = 0.25
"""Share by which a camera may round an exposure time in steps that it does not state; the rounded time is recorded."""
CHANGE = "change the camera settings of the trajectory"


class GenicamNodes(Nodes, Protocol):
    """Settings by the names of the standard."""

    def limits(self, name: str) -> Limits:
        """What a number may be now."""
        ...


@dataclass(frozen=True)
class Delivery:
    """An undamaged picture of a stream."""

    data: Pixels
    pixel_format: str
    number: int | None
    """Counts the pictures of the stream; None if the library does not say it."""
    ticks: int
    host_time_ns: int
    """When the exposure was triggered, on the monotonic clock of the host [ns]."""
    chunks: Mapping[str, float]
    """What the camera sent with the picture, by the names of `CHUNKS`."""


def exposed_at(nodes: Nodes, ticks: int, triggered_ns: int) -> int:
    """When an exposure began on the host's monotonic clock [ns]; at its trigger, if the camera's clock cannot be read.

    Some models begin tens of milliseconds after their trigger. Here the camera's clock is latched between two readings of the
    host's. A time stamp that would then lie in front of the trigger, or in the future, is of another clock.

    Args:
        ticks: time stamp of the picture, by the camera's clock; 0 without one.
        triggered_ns: when it was triggered, by the host's clock.
    """
    latch = first(nodes, LATCHES)
    if latch is None or not ticks:
        return triggered_ns
    before_ns = time.monotonic_ns()
    nodes.write(latch, None)
    after_ns = time.monotonic_ns()
    tick_ns = 1e9 / float(nodes.read(FREQUENCY)) if nodes.has(FREQUENCY) else 1.0
    begun_ns = (before_ns + after_ns) // 2 - round((int(nodes.read(LATCHES[latch])) - ticks) * tick_ns)
    uncertain_ns = (after_ns - before_ns) // 2
    if not triggered_ns - uncertain_ns <= begun_ns <= after_ns:
        return triggered_ns
    return max(begun_ns, triggered_ns)


class GenicamCamera(CameraDriver):
    """A camera with constant exposure and gain, triggered by software. What it lacks must be in `device.leave`.

    A picture belongs to its trigger. What came before is thrown away, the stream is started again after a picture that did not
    come in time, and a picture that does not carry the next number, or the exposure time that was set, is taken again.
    """

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        super().__init__(settings, device)
        self._is_late = False  # the stream may still deliver the picture of an earlier trigger
        self._number: int | None = None  # of the newest picture of the stream
        self._chunks: list[str] = []  # what the camera sends with its pictures

    def grab(self) -> Image:
        """Trigger one exposure and wait for it; takes it again up to `TRIES` times."""
        self._require_open()
        why = ""
        for _ in range(TRIES):
            try:
                if self._is_late:
                    self._stop()
                    self._start()
                delivered = self._expose()
            except Exception as error:
                if not self._is_vendors(error):
                    raise
                self._is_late = True
                raise self._missing(error) from None
            why = delivered if isinstance(delivered, str) else self._foreign(delivered)
            if not why and isinstance(delivered, Delivery):
                return self._image(delivered)
            event("retry", camera=self.name, why=why)
        remedy = "check cable and bandwidth, then resume with --resume"
        raise CaptureError(f"camera gave {TRIES} damaged images in a row", where=self.name, why=why, remedy=remedy)

    @abstractmethod
    def _expose(self) -> Delivery | str:
        """Throw away what the stream holds, trigger one exposure, and wait `_patience_s` for it; a word on a damaged picture."""

    @abstractmethod
    def _stop(self) -> None:
        """Stop the stream and drop what it holds."""

    def _start(self) -> None:
        """Start a stream, whose pictures are counted anew."""
        self._is_late, self._number = False, None

    @property
    def _is_unplugged(self) -> bool:
        """Whether the library knows that the camera is gone."""
        return False

    @property
    def _patience_s(self) -> float:
        return TRANSFER_S + 1e-6 * self._exposure_us

    def _missing(self, error: Exception) -> CaptureError:
        """What a picture that did not come means."""
        if self._is_unplugged:
            remedy = "plug it in and resume with --resume"
            return RigConnectionError("camera was unplugged", where=self.name, remedy=remedy)
        late = type(error).__name__ == "TimeoutException"
        why = f"nothing within {self._patience_s:.1f} s" if late else first_line(error)
        remedy = "check its cable and resume with --resume"
        return RigConnectionError("camera gave no image", where=self.name, why=why, remedy=remedy)

    def _foreign(self, delivered: Delivery) -> str:
        """Why a picture is not that of the newest trigger; empty: it is."""
        before, number = self._number, delivered.number
        self._number = None if "trigger" in self.device.leave else number  # without a trigger many are thrown away
        if before is not None and number is not None and number != before + 1:
            return f"picture {number} came after {before}"
        exposed, wanted = delivered.chunks.get("ExposureTime"), self._exposure_us
        if exposed is not None and abs(exposed - wanted) > ROUNDED * wanted:
            return f"it was exposed for {exposed:g} us, not {wanted:g} us"
        return ""

    def _image(self, delivered: Delivery) -> Image:
        data, name, said = delivered.data, delivered.pixel_format, delivered.chunks
        raw = data.astype(np.uint16) if name.endswith("12") else None
        exposure_us, gain_db = said.get("ExposureTime", self._exposure_us), said.get("Gain", self._gain_db)
        ticks = int(said.get("Timestamp", delivered.ticks))
        begun_ns = exposed_at(self.nodes, ticks, delivered.host_time_ns)
        return Image(colours(data, name), exposure_us, gain_db, ticks, begun_ns, raw)

    def _switch_chunks_on(self) -> None:
        """Have the camera send with each picture what it says of it, where it can."""
        nodes = self.nodes
        if not nodes.has("ChunkModeActive"):
            return
        nodes.write("ChunkModeActive", True)  # only then does it show its selector
        offered = nodes.symbolics("ChunkSelector") if nodes.has("ChunkSelector") else ()
        self._chunks = [name for name in CHUNKS if name in offered]
        for name in self._chunks:
            put(nodes, "ChunkSelector", name)
            put(nodes, "ChunkEnable", True)
        if not self._chunks:
            nodes.write("ChunkModeActive", False)

    @property
    @abstractmethod
    def nodes(self) -> GenicamNodes:
        """Its settings; it must be open."""

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures to the nearest that the camera takes [us].

        Sensors with a rolling shutter expose in steps of a row, 35 us on some. The camera's own time is what pictures state.

        Raises CaptureError: the camera rejects it, or has none.
        """
        self._require_open()
        name = first(self.nodes, EXPOSURES)
        if name is None or "exposure_us" in self.device.leave:
            why = "it has no ExposureTime, or camera.leave names it"
            remedy = "list exposure_us in camera.leave, and take no brackets"
            raise CaptureError("camera takes no exposure time", where=self.name, why=why, remedy=remedy)
        with self._named():
            limits = self.nodes.limits(name)
            put(self.nodes, name, limits.nearest(exposure_us), tolerance=max(limits.step / 2, ROUNDED * exposure_us))

    @property
    def region(self) -> Region:
        """The region of the sensor in the images, as read back."""
        read = self._read
        return Region(read("Width"), read("Height"), read("OffsetX", 0), read("OffsetY", 0), read("BinningHorizontal", 1))

    @property
    def binning_modes(self) -> dict[str, str]:
        """What becomes of binned pixels, `horizontal` and `vertical`: Average, Sum, or empty if the camera does not say it."""
        unsaid = UNSAID.get(str(self._read("DeviceModelName", "")), {})
        return {axis: str(self._read(f"{name}Mode", unsaid.get(axis, ""))) for axis, name in BINNING.items()}

    @property
    def binning_gain(self) -> int:
        """How many times as bright as an unbinned pixel a binned one is, at the same exposure time."""
        return math.prod(int(self._read(name, 1)) for axis, name in BINNING.items() if self.binning_modes[axis] == SUM)

    @property
    def black_level(self) -> float:
        """What the camera adds to every value [share of the largest value]; 0 if it counts that in units of its own."""
        return float(self._read("BlackLevel", 0.0)) / (4095 if self.settings.keeps_raw else 255)

    def _configure(self) -> None:
        """Bring the camera to its known state, then to the settings of the trajectory and of the rig file."""
        wanted, nodes, leave, where = self.settings, self.nodes, self.device.leave, self.name
        if "factory_settings" not in leave:
            if not nodes.has("UserSetLoad"):
                refusals.require_left(self.device, "factory_settings", "it has no UserSetLoad", where)
            load_default(nodes)
        set_plain(nodes)
        for automatic in AUTOMATICS:
            if nodes.has(automatic):
                put(nodes, automatic, "Off")
        put(nodes, "PixelFormat", choose_format(wanted.pixel_format, nodes.symbolics("PixelFormat"), where=where))
        if self.device.radiometry and wanted.keeps_raw:
            set_pedestal(nodes)
        if "colour_space" not in leave:
            set_colour_space(nodes, encoded=wanted.pixel_format == "rgb8")
        self._set_region()
        if "exposure_us" not in leave:
            self.set_exposure(wanted.exposure_us / self.binning_gain)
        if "gain_db" not in leave:
            if (gain := first(nodes, GAINS)) is None:
                refusals.require_left(self.device, "gain_db", "it has no Gain", where)
            else:
                put(nodes, gain, wanted.gain_db, tolerance=0.05)
        if "trigger" not in leave:
            if not nodes.has("TriggerMode"):
                refusals.require_left(self.device, "trigger", "it has no TriggerMode", where)
            for name, value in TRIGGER.items():
                put(nodes, name, value)
        self._switch_chunks_on()
        put_all(nodes, self.device.settings, where)

    def _set_region(self) -> None:
        """Binning, then size and place of the region, centred unless the trajectory says where it is."""
        wanted, nodes = self.settings, self.nodes
        if wanted.binning > 1 or nodes.has("BinningHorizontal"):
            for name in BINNING.values():
                put(nodes, name, wanted.binning)
                if nodes.has(mode := f"{name}Mode") and AVERAGE in nodes.symbolics(mode):
                    with suppress(CaptureError):  # some list it and do not take it; what they have is recorded
                        nodes.write(mode, AVERAGE)
        for name in ("OffsetX", "OffsetY"):
            if nodes.has(name):
                put(nodes, name, 0)
        edges = {"Width": (wanted.width, wanted.offset_x, "OffsetX"), "Height": (wanted.height, wanted.offset_y, "OffsetY")}
        for name, (edge, offset, place) in edges.items():
            available = self._edge(name)
            put(nodes, name, edge)
            if nodes.has(place):
                step = int(nodes.limits(place).step)
                put(nodes, place, offset if offset is not None else max(available - edge, 0) // 2 // step * step)
            elif offset:
                why, remedy = f"offset {offset} was requested", "remove the offsets"
                raise CaptureError(f"camera has no {place}", where=self.name, why=why, remedy=remedy)

    def _edge(self, name: str) -> int:
        """Width or height of the sensor [binned px]; that of the region if the camera does not say it."""
        return int(self._read(f"{name}Max", self._read(name)))

    @property
    def _sensor(self) -> dict[str, int]:
        binning = self.region.binning
        return {"width": self._edge("Width") * binning, "height": self._edge("Height") * binning}

    @property
    def _exposure_us(self) -> float:
        name = first(self.nodes, EXPOSURES)
        return float(self.nodes.read(name)) if name else self.settings.exposure_us

    @property
    def _gain_db(self) -> float:
        name = first(self.nodes, GAINS)
        return float(self.nodes.read(name)) if name else self.settings.gain_db

    def _read(self, name: str, default: Any = None) -> Any:
        return self.nodes.read(name) if default is None or self.nodes.has(name) else default
