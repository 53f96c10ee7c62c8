"""What a robot and a camera must do. Drivers in `robots/` and `cameras/` do it for real hardware.

Both are context managers: entering connects completely or leaves nothing open, leaving closes.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RobotState:
    """Where the arm is, at one time stamp of its controller."""

    base_from_flange: NDArray[np.float64]
    """(4, 4) flange pose [m]; the active tool centre point has been removed."""
    joints: NDArray[np.float64]
    """(6,) measured angles [rad]."""
    joint_speeds: NDArray[np.float64]
    """(6,) measured [rad/s]."""
    robot_time_s: float
    """The controller's time stamp [s]."""
    host_time_ns: int
    """Monotonic host clock on arrival [ns]."""


@dataclass(frozen=True)
class Image:
    """One exposure as the camera delivered it."""

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    """(height, width, 3) RGB."""
    exposure_us: float
    """As read back from the camera."""
    gain_db: float
    """As read back from the camera."""
    device_ticks: int
    """The camera's own time stamp at exposure."""
    host_time_ns: int
    """Monotonic host clock when the exposure was triggered [ns]."""


class Robot(Protocol):
    """An arm that goes to joint angles and says where it is."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: NDArray[np.float64], *, speed: float, acceleration: float) -> None:
        """Move to (6,) joint angles [rad] at most at `speed` [rad/s] and `acceleration` [rad/s^2]; return when settled.

        Raises a CaptureError that says what happened and in what state the arm was left: stopped, always.
        """

    def state(self) -> RobotState:
        """The newest state; raises where it is older than 0.2 s."""
        ...

    def stop(self) -> None:
        """Bring the arm to rest now. May be called from another thread, and twice."""

    def description(self) -> dict[str, Any]:
        """What the recording keeps of the arm: model, serial, software version, tool offset."""
        ...


class Camera(Protocol):
    """A camera with constant exposure and gain that takes a picture when told."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

    def grab(self) -> Image:
        """Trigger one exposure and wait for it. Raises a CaptureError after its own deadline."""
        ...

    def description(self) -> dict[str, Any]:
        """What the recording keeps of the camera: model, serial, full state as read back."""
        ...
