"""Opens the camera of a rig file: the driver that its `model` names, and the view of it that `capture doctor` has."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from koala3d.capture.drivers.cameras.nodes import Nodes
from koala3d.capture.drivers.protocols import Camera
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

if TYPE_CHECKING:
    from koala3d.capture.sim.realsense_device import SoftwareRealSense


def camera_of(device: Device, settings: CameraSettings) -> Camera:
    """The driver of a real camera with the settings of a trajectory; entering it connects."""
    if device.model == "genicam":
        from koala3d.capture.drivers.cameras.gentl import GenTlCamera

        return GenTlCamera(settings, device)
    if device.model == "opencv":
        from koala3d.capture.drivers.cameras.opencv import OpenCvCamera

        return OpenCvCamera(settings, device)
    if device.model == "realsense":
        from koala3d.capture.drivers.cameras.realsense import RealSense

        return RealSense(settings, device)
    if device.model == "gphoto2":
        from koala3d.capture.drivers.cameras.gphoto import GphotoCamera

        return GphotoCamera(settings, device)
    from koala3d.capture.drivers.cameras.basler import Basler

    return Basler(settings, serial=device.serial, own=device.settings)


@dataclass(frozen=True)
class Seen:
    """A camera that was opened only to look at it."""

    nodes: Nodes
    serial: str
    facts: dict[str, str] = field(default_factory=dict)
    """What it says of `firmware` and `link` beside its settings."""


@contextmanager
def seen(device: Device, *, simulated: bool = False, number: int = 0) -> Iterator[Seen]:
    """Open a camera only to look at it; a simulated one where it has an emulation of its own, else that of pylon.

    Args:
        number: which of the rig's cameras it is, from 0, of simulated ones.

    Raises RigConnectionError: there is none, or several and no serial number, or another program uses it.
    """
    if device.model == "realsense":
        from koala3d.capture.drivers.cameras import realsense

        emulation = _emulation() if simulated else None
        asked = device.model_copy(update={"serial": ""}) if simulated else device
        with realsense.opened(asked, emulation=emulation) as (nodes, serial, said):
            yield Seen(nodes, serial, {"firmware": said["firmware_version"], "link": said["usb_type_descriptor"]})
    elif simulated or device.model == "basler":
        from koala3d.capture.drivers.cameras import basler

        with basler.opened(basler.serial_of(number) if simulated else device.serial, emulated=simulated) as (pylon, serial):
            yield Seen(pylon, serial)
    elif device.model == "genicam":
        from koala3d.capture.drivers.cameras import gentl

        with gentl.opened(device) as (found, serial):
            yield Seen(found, serial)
    elif device.model == "opencv":
        from koala3d.capture.drivers.cameras import opencv

        with opencv.opened(device) as (properties, serial):
            yield Seen(properties, serial)
    else:
        from koala3d.capture.drivers.cameras import gphoto

        with gphoto.opened(device) as (words, serial):
            yield Seen(words, serial, {"firmware": str(words.read("deviceversion"))})


def _emulation() -> "SoftwareRealSense":
    import numpy as np

    from koala3d.capture.sim.realsense_device import SoftwareRealSense
    from koala3d.capture.sim.truth import RigTruth

    return SoftwareRealSense(RigTruth.draw(np.eye(4), 0).sensor_camera)
