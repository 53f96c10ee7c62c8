"""What a robot and a camera measure: the value types that their drivers return."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8 | np.uint16]  # a picture, (height, width, 3), or 1 channel from a grey sensor


@dataclass(frozen=True)
class RobotState:
    """Where the arm is, at one time stamp of its controller."""

    base_from_flange: NDArray[np.float64]  # (4, 4) flange pose [m]; the active tool centre point has been removed
    joints: NDArray[np.float64]  # (n,) measured angles [rad]
    joint_speeds: NDArray[np.float64]  # (n,) measured [rad/s]
    robot_time_s: float  # the controller's time stamp [s]
    host_time_ns: int  # monotonic host clock on arrival [ns]
    joint_temperatures: tuple[float, ...] | None = None  # [degrees Celsius]; None: not reported


@dataclass(frozen=True)
class Image:
    """One exposure as the camera delivered it."""

    pixels: Pixels  # sRGB
    exposure_us: float  # as read back from the camera
    gain_db: float  # as read back from the camera
    device_ticks: int  # the camera's own time stamp at exposure
    host_time_ns: int  # monotonic host clock when the exposure was triggered [ns]
    raw: NDArray[np.uint16] | None = None  # (height, width) values of 12 bits, in raw formats of 12 bits
    depth: NDArray[np.uint16] | None = None  # (height, width) of a depth sensor beside the picture, in its own units and pixels
