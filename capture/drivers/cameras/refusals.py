"""What drivers refuse: settings of a trajectory that a camera does not take, each with the values that it would take."""

from collections.abc import Mapping

import numpy as np

from koala3d.capture.drivers.errors import CaptureError
from koala3d.capture.model.device import Device
from koala3d.capture.model.trajectory import CameraSettings

SHARE = 0.01
"""Relative difference between a setting that was asked for and the one that a camera has, which its steps may cause."""


def refuse_region(settings: CameraSettings, where: str) -> None:
    """Raise CaptureError where a camera without regions of its sensor is asked for one."""
    if settings.binning > 1:
        why, remedy = f"binning {settings.binning} was requested", "set camera.binning to 1 and the size to one of its modes"
        raise CaptureError("camera has no binning", where=where, why=why, remedy=remedy)
    if settings.offset_x or settings.offset_y:
        why = f"offset {settings.offset_x}, {settings.offset_y} was requested"
        raise CaptureError("camera has no region of its sensor", where=where, why=why, remedy="remove the offsets")


def refuse_size(settings: CameraSettings, actual: tuple[int, int], where: str, offered: str = "") -> None:
    """Raise CaptureError unless the pictures have the size of the trajectory."""
    wanted = (settings.width, settings.height)
    if actual != wanted:
        why = f"requested {wanted[0]}x{wanted[1]}, actual {actual[0]}x{actual[1]}" + (f"; it offers {offered}" if offered else "")
        raise CaptureError("camera changed the size of its pictures", where=where, why=why, remedy="set camera.width and height")


def refuse_format(settings: CameraSettings, offered: tuple[str, ...], where: str) -> None:
    """Raise CaptureError where the driver does not deliver the format of the trajectory."""
    if settings.pixel_format not in offered:
        why, remedy = f"it offers {', '.join(offered)}", f"set camera.pixel_format to {' or '.join(offered)}"
        raise CaptureError(f"camera does not send {settings.pixel_format}", where=where, why=why, remedy=remedy)


def require_left(device: Device, what: str, why: str, where: str) -> None:
    """Raise CaptureError unless the rig file says that a setting which the camera cannot take is left."""
    if what not in device.leave:
        remedy = f"set it by hand or in camera.settings, and list {what} in camera.leave"
        raise CaptureError(f"camera takes no {what}", where=where, why=why, remedy=remedy)


def refuse_impossible(value: float, low: float, high: float, name: str, where: str) -> None:
    """Raise CaptureError where a value is outside what a camera can take."""
    if not (low <= value <= high and np.isfinite(value)):
        why = f"requested {value:g}, possible: {low:g} to {high:g}"
        raise CaptureError(f"camera rejected {name}", where=where, why=why, remedy="change the camera settings of the trajectory")


def nearest_choice(wanted: float, choices: Mapping[str, float], name: str, where: str) -> str:
    """The choice whose value is within `SHARE` of the wanted one. Raises CaptureError: there is none; lists the nearest."""
    near = sorted(choices, key=lambda one: abs(choices[one] - wanted))
    if not near or abs(choices[near[0]] - wanted) > SHARE * wanted:
        why = f"requested {wanted:g}, nearest: {', '.join(f'{one} ({choices[one]:g})' for one in near[:3]) or 'none'}"
        raise CaptureError(f"camera rejected {name}", where=where, why=why, remedy="change the camera settings of the trajectory")
    return near[0]
