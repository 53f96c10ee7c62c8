"""What the drivers of all cameras share: opening and closing, the errors of both, and the choice among several cameras."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

from koala3d.capture.drivers.cameras.nodes import Nodes
from koala3d.capture.drivers.errors import CaptureError, RigConnectionError
from koala3d.capture.drivers.measurements import Image
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

Found = TypeVar("Found")


@dataclass(frozen=True)
class InspectedCamera:
    """A camera that was opened only to look at it."""

    nodes: Nodes
    serial: str
    facts: Mapping[str, str] = field(default_factory=dict)
    """What is known beside its settings: `firmware`, `link`, `transport` (as its library calls it)."""


class CameraDriver(ABC):
    """One camera with the settings of a trajectory and of a rig file.

    Use as a context manager. The constructor does no I/O. Entering connects, writes every setting and reads it back; on any
    failure all is closed again.
    """

    busy = "close other programs that use it, or plug it in again"
    """What to do if the maker's library refuses to open the camera."""

    def __init__(self, settings: CameraSettings, device: Device) -> None:
        self.settings, self.device = settings, device
        self._camera: Any = None  # the library's own object, while the camera is open

    def __enter__(self) -> Self:
        with self._closed_on_failure():
            self._begin()
            if self.settings.brackets > 1:  # what the camera does not take is refused now, not at the first view
                first_us = float(self.description()["exposure_us"])
                for exposure_us in [*self.settings.shorter_us(first_us), first_us]:
                    self.set_exposure(exposure_us)
        return self

    def __exit__(self, *exception: object) -> None:
        self._close()

    @contextmanager
    def inspected(self) -> Iterator[InspectedCamera]:
        """Connect only to look at the camera: nothing is written and nothing starts. Raises as entering does."""
        with self._closed_on_failure():
            self._connect()
        try:
            yield InspectedCamera(self.nodes, self.serial, self.facts)
        finally:
            self._close()

    @abstractmethod
    def grab(self) -> Image:
        """See `capture.drivers.protocols.Camera`."""

    @abstractmethod
    def set_exposure(self, exposure_us: float) -> None:
        """See `capture.drivers.protocols.Camera`."""

    @abstractmethod
    def description(self) -> dict[str, Any]:
        """See `capture.drivers.protocols.Camera`."""

    @property
    def name(self) -> str:
        """What messages call it."""
        return f"camera {self.device.serial}" if self.device.serial else "camera"

    @property
    @abstractmethod
    def nodes(self) -> Nodes:
        """Its settings; it must be open."""

    @property
    @abstractmethod
    def serial(self) -> str:
        """Its serial number as it says; it must be open."""

    @property
    def facts(self) -> Mapping[str, str]:
        """See `InspectedCamera`."""
        return {}

    @abstractmethod
    def _connect(self) -> None:
        """Find the camera and open it; sets `_camera`."""

    @abstractmethod
    def _begin(self) -> None:
        """Connect, write the settings and start what must run."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of all that is open. May be called twice."""

    @staticmethod
    @abstractmethod
    def _is_vendors(error: BaseException) -> bool:
        """Whether an exception is of the maker's library."""

    def _require_open(self) -> None:
        if self._camera is None:
            raise CaptureError("camera is closed", where=self.name, remedy="open it first")

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Errors raised inside name the camera unless they name something else."""
        try:
            yield
        except CaptureError as error:
            if error.where:
                raise
            raise type(error)(error.what, where=self.name, why=error.why, remedy=error.remedy) from None

    @contextmanager
    def _closed_on_failure(self) -> Iterator[None]:
        try:
            with self._named():
                yield
        except BaseException as error:
            self._close()
            if self._is_vendors(error):
                why = first_line(error)
                raise RigConnectionError("camera could not be set up", where=self.name, why=why, remedy=self.busy) from None
            raise


def only_one(
    found: Sequence[tuple[str, Found]], serial: str, where: str, *, kind: str = "camera", words: str = "", remedy: str
) -> Found:
    """The device with a serial number, or the only one if that is empty.

    Args:
        found: serial numbers and devices.
        words: the devices as messages list them; empty: by their serial numbers.
        remedy: what to do if there is none.

    Raises RigConnectionError: there is none, or several.
    """
    chosen = [device for one, device in found if serial in ("", one)]
    words = words or ", ".join(one for one, _ in found)
    if not chosen:
        raise RigConnectionError(f"no {kind} was found", where=where, why=f"connected: {words or 'none'}", remedy=remedy)
    if len(chosen) > 1:
        remedy = "write the serial number into the rig file"
        raise RigConnectionError(f"several {kind}s are connected", where=where, why=words, remedy=remedy)
    return chosen[0]


def first_line(error: BaseException) -> str:
    """What a library says, without where in its own code."""
    return str(error).splitlines()[0] if str(error) else type(error).__name__
