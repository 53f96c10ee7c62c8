"""What can go wrong with a rig: each error says what happened, in what state the rig was left, and what to do."""

from datasets.core.errors import KoalaError


class CaptureError(KoalaError):
    """Something went wrong between the trajectory and the recording."""


class RigConnectionError(CaptureError):
    """A device could not be reached, or was lost. Names the device, its address and what was found there."""


class NotReady(CaptureError):
    """The robot is reachable but not in a state to move: powered off, stopped for safety, not in remote control."""


class ProtectiveStop(CaptureError):
    """The controller stopped the arm for safety. It needs a person; it is never cleared from here."""


class MotionError(CaptureError):
    """A motion did not end where and when it should have. The arm has been stopped."""


class UnreachableError(CaptureError):
    """Viewpoints that the arm cannot take. Names each, and the limit that it meets."""

    exit_code = 2


class SafetyError(CaptureError):
    """A target outside the limits of speed, joints or space. Nothing has moved."""


class PlanningError(CaptureError):
    """No motion was found between two reachable views."""


class SimulationError(CaptureError):
    """The simulated rig could not be started or has ended."""
