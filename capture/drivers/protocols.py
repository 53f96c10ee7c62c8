"""What a robot, a camera and a turntable must do. Drivers in `ur/`, `cameras/` and `turntable/` do it for real hardware.

All are context managers: entering connects completely or leaves nothing open, leaving closes.
"""

from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.measurements import Image, RobotState

__all__ = ["Camera", "GroundTruth", "Image", "Robot", "RobotState", "Turntable"]


class Robot(Protocol):
    """An arm that moves to joint angles and reports its state."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

    def move_to(self, joints: NDArray[np.float64], *, speed: float, acceleration: float) -> None:
        """Move to (n,) joint angles [rad] with at most `speed` [rad/s] and `acceleration` [rad/s^2]; return when settled.

        Raises a CaptureError that says what happened. The arm is always stopped then.
        """

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        """The newest state, taken after a time of the monotonic host clock [ns]; raises where none comes."""
        ...

    def stop(self) -> None:
        """Stop the arm now; nothing moves until `clear_stop`. May be called twice and from another thread."""

    def clear_stop(self) -> None:
        """Allow motions again after `stop`."""

    def description(self) -> dict[str, Any]:
        """What the manifest stores about the arm: client, model, serial, software version, tool offset."""
        ...


class Camera(Protocol):
    """A camera with constant gain that takes a picture on request."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

    def grab(self) -> Image:
        """Trigger one exposure and wait for it. Raises a CaptureError after its own deadline."""
        ...

    def set_exposure(self, exposure_us: float) -> None:
        """Change the exposure time of the next pictures [us]. Raises a CaptureError where the camera rejects it."""

    def description(self) -> dict[str, Any]:
        """What the manifest stores about the camera: model, serial, full state as read back."""
        ...


class Turntable(Protocol):
    """A table that turns the object to an angle and holds it there."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *exception: object) -> None: ...

    def turn_to(self, angle: float) -> None:
        """Turn to an angle [rad], counted over whole turns, and return when the table stands still.

        Raises a CaptureError that says what happened. The table is always stopped then.
        """

    def angle(self) -> float:
        """The angle that the controller reports now [rad]. Raises a CaptureError where it does not answer."""
        ...

    def stop(self) -> None:
        """Stop the table now. May be called twice and from another thread."""

    def description(self) -> dict[str, Any]:
        """What the manifest stores about the table: driver, address, version of the controller."""
        ...


class GroundTruth(Protocol):
    """Saves what is true of each picture. Only a simulation knows it."""

    def prepare(self, frame: int) -> None:
        """Announce the number of the next frame."""

    def save_truth(self, folder: Path, name: str, split: str) -> None:
        """Write the truth about the newest picture."""
