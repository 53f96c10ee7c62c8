"""Errors of a rig. Each says what happened, in which state the rig was left, and what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from koala3d.datasets.core.errors import KoalaError


class CaptureError(KoalaError):
    """Something went wrong between the trajectory and the recording."""


class RigConnectionError(CaptureError):
    """A device could not be reached, or was lost. Names the device, its address and what was found there."""


class ConnectionLapse(RigConnectionError):
    """The connection to an arm failed while it was safe: it stopped when it was ordered to, and nothing stopped it for safety.

    Entering it again may mend that.
    """


class NotReady(CaptureError):
    """The robot is reachable but cannot move: powered off, in a safety stop, or not in remote control."""


class ProtectiveStop(CaptureError):
    """The controller stopped the arm for safety. A person must clear it; Koala never does."""


class MotionError(CaptureError):
    """A motion did not end at the expected place or time. The arm has been stopped."""


class NotSettled(MotionError):
    """The arm is at its target and does not come to rest. It is still connected, and may be moved again."""


class StopLatched(MotionError):
    """Somebody stopped the arm. Nothing moves until that is cleared on purpose."""


class UnreachableError(CaptureError):
    """The arm cannot take some viewpoints. Names each with its reason."""

    exit_code = 2


class SafetyError(CaptureError):
    """A target is outside the limits of speed, joints or space. Nothing has moved."""


class PlanningError(CaptureError):
    """No path was found between two reachable views."""


class SimulationError(CaptureError):
    """The simulated rig could not be started or has ended."""


@contextmanager
def naming(camera: str) -> Iterator[None]:
    """Errors raised inside say which camera of the rig they are about; the only camera of a rig has the empty name."""
    try:
        yield
    except KoalaError as error:
        if not camera:
            raise
        where = ", ".join(filter(None, (f"camera '{camera}'", error.where)))
        raise type(error)(error.what, where=where, why=error.why, remedy=error.remedy) from error
