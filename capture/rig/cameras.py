"""Opens the camera of a rig file: the driver that its `model` names, and the view of it that `capture doctor` has."""

from contextlib import AbstractContextManager

from koala3d.capture.drivers.cameras.base import CameraDriver, Seen
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings


def camera_of(device: Device, settings: CameraSettings) -> CameraDriver:
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

    return Basler(settings, device)


def seen(device: Device, *, simulated: bool = False, number: int = 0) -> AbstractContextManager[Seen]:
    """Open a camera only to look at it; a simulated one by its own emulation if it has one, else by that of pylon.

    Args:
        number: which of the rig's cameras it is, from 0, if it is simulated.

    Raises RigConnectionError: there is none, or several and no serial number, or another program uses it.
    """
    return (_emulated(device, number) if simulated else camera_of(device, CameraSettings())).seen()


def _emulated(device: Device, number: int) -> CameraDriver:
    if device.model != "realsense":
        from koala3d.capture.drivers.cameras.basler import Basler, serial_of

        return Basler(CameraSettings(), Device(serial=serial_of(number)), emulated=True)
    import numpy as np

    from koala3d.capture.drivers.cameras.realsense import RealSense
    from koala3d.capture.sim.realsense_device import SoftwareRealSense
    from koala3d.capture.sim.truth import RigTruth

    source = SoftwareRealSense(RigTruth.draw(np.eye(4), 0).sensor_camera)
    return RealSense(CameraSettings(), device.model_copy(update={"serial": ""}), emulation=source)
