"""Options of RealSense sensors by librealsense's names, the state that sessions start from, and the factory's calibration."""

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.cameras.nodes import Nodes, put
from koala3d.capture.drivers.errors import CaptureError
from koala3d.datasets.camera_model import Camera

DEPTH = "depth."  # before a name in camera.settings: of the depth sensor
PLAIN = {"enable_auto_exposure": 0.0, "enable_auto_white_balance": 0.0, "auto_exposure_priority": 0.0}
"""Automatic functions, and the values that switch them off."""
DEFAULTS = "backlight_compensation brightness contrast gamma hue saturation sharpness white_balance".split()
"""Settings of the colour sensor that are brought to the factory's values, whatever was set before."""


class OptionNodes:
    """`capture.drivers.cameras.nodes.Nodes` of opened sensors. Options of the depth sensor begin with `depth.`."""

    def __init__(self, rs: Any, colour: Any, depth: Any = None) -> None:
        self._rs, self._sensors = rs, {"": colour, DEPTH: depth}

    def has(self, name: str) -> bool:
        """Whether the sensor supports the option."""
        sensor, option = self._place(name)
        return sensor is not None and option is not None and sensor.supports(option)

    def read(self, name: str) -> float:
        """Its value."""
        sensor, option = self._place(name)
        return float(sensor.get_option(option))

    def default(self, name: str) -> float:
        """The factory's value."""
        sensor, option = self._place(name)
        return float(sensor.get_option_range(option).default)

    def symbolics(self, name: str) -> Collection[str]:
        """None: all are numbers."""
        return ()

    def write(self, name: str, value: Any) -> None:
        """Set a number. Raises CaptureError: it is outside the option's range, or the sensor rejects it."""
        sensor, option = self._place(name)
        try:
            sensor.set_option(option, float(value))
        except (RuntimeError, TypeError, ValueError):
            limits, remedy = sensor.get_option_range(option), "change the camera settings"
            why = f"requested {value}, possible: {limits.min:g} to {limits.max:g} in steps of {limits.step:g}"
            raise CaptureError(f"camera rejected {name}", why=why, remedy=remedy) from None

    def values(self) -> dict[str, float]:
        """All options that can be read."""
        found = {}
        for prefix, sensor in self._sensors.items():
            if sensor is None:
                continue
            for option in sensor.get_supported_options():
                try:
                    found[f"{prefix}{option.name}"] = float(sensor.get_option(option))
                except RuntimeError:
                    continue  # it has no value before the sensor has measured
        return found

    def _place(self, name: str) -> tuple[Any, Any]:
        prefix = DEPTH if name.startswith(DEPTH) else ""
        return self._sensors[prefix], getattr(self._rs.option, name.removeprefix(prefix), None)


def set_start_state(nodes: Nodes, default: Callable[[str], float]) -> None:
    """Automatic functions off, and the factory's values of all that changes colours; `default` says them by name."""
    for name in DEFAULTS:
        if nodes.has(name) and name != "white_balance":
            put(nodes, name, default(name))
    for name, value in PLAIN.items():
        if nodes.has(name):
            put(nodes, name, value)
    if nodes.has("white_balance"):  # can be set only where it is not automatic
        put(nodes, "white_balance", default("white_balance"))


def factory_camera(profile: Any) -> dict[str, Any]:
    """Intrinsics that a camera keeps of one of its modes, in our pixel coordinates.

    Its model of distortion may be none of OpenCV's: coefficients that are not zero are given as they are, with the model's name.
    """
    seen = profile.as_video_stream_profile().get_intrinsics()
    camera = Camera(seen.width, seen.height, seen.fx, seen.fy, seen.ppx + 0.5, seen.ppy + 0.5)  # centres are at integers there
    return {"camera": camera.to_json(), "distortion": {"model": seen.model.name, "coefficients": list(seen.coeffs)}}


def rigid(extrinsics: Any) -> NDArray[np.float64]:
    """(4, 4) transform [m] of librealsense, which has the columns of the rotation one after the other."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(extrinsics.rotation, (3, 3)).T
    matrix[:3, 3] = extrinsics.translation
    return matrix
