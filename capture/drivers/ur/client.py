"""What a client of the controller is: the driver's child process holds one.

Two exist: `ur_rtde`, the vendor's library, and `koala`, one of our own in plain sockets for platforms without it.
"""

import importlib.util
from collections.abc import Sequence
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from typing import Protocol, TypedDict


class ClientChoice(StrEnum):
    """Which client to take; AUTO: the vendor's where it can be imported."""

    AUTO = "auto"
    UR_RTDE = "ur_rtde"
    KOALA = "koala"


def is_vendors(choice: str) -> bool:
    """Whether a choice means the vendor's client: it is asked for, or it is installed and none is."""
    installed = importlib.util.find_spec("rtde_control") is not None
    return choice == ClientChoice.UR_RTDE or (choice == ClientChoice.AUTO and installed)


class StartFailure(StrEnum):
    """Why a client did not start."""

    IN_USE = "in use"  # another program controls the robot
    MISSING = "missing"  # the client is not installed
    OTHER = "other"


class StartError(RuntimeError):
    """A client did not start; nothing moves."""

    def __init__(self, why: str, failure: StartFailure = StartFailure.OTHER) -> None:
        super().__init__(why)
        self.failure = failure


class State(TypedDict):
    """One sample of the controller, and what the client knows about its connection and motion."""

    robot_time_s: float
    joints: list[float]
    joint_speeds: list[float]
    tcp_pose: list[float]
    joint_temperatures: list[float]  # [degrees Celsius]
    speed_fraction: float
    safety_bits: int
    connected: bool
    running: bool  # whether the control program runs and is not paused
    operation: int  # number of the latest motion, 0 to 127
    moving: bool
    host_time_ns: int


class Client(Protocol):
    """A connection to the controller with the control program running. One thread uses it."""

    name: str  # name and version

    def state(self) -> State:
        """The newest sample."""
        ...

    def move(self, joints: Sequence[float], speed: float, acceleration: float) -> int | None:
        """Start a motion. Returns the number of the motion before it, or None if the controller refuses the new one."""
        ...

    def stop(self, deceleration: float) -> None:
        """Bring the arm to rest [rad/s^2], and hold it; returns at once."""
        ...

    def freedrive(self, on: bool) -> bool:
        """Let a person move the arm by hand, or hold it; whether the controller did so."""
        ...

    def kick(self) -> None:
        """Show the controller's watchdog that somebody is there."""
        ...

    def tcp_offset(self) -> list[float]:
        """(6,) position [m] and rotation vector [rad] of the tool in the flange."""
        ...

    def leave(self) -> None:
        """Let the arm come to rest."""
        ...


def versioned(name: str, package: str) -> str:
    """The client's name with the version of its package, where that is installed as one."""
    try:
        return f"{name} {version(package)}"
    except PackageNotFoundError:
        return name
