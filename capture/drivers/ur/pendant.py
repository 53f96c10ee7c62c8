"""What the driver asks of a controller beside moving the arm: is it ready, does a program run, end it.

PolyScope 5 has a dashboard server for this. PolyScope X has none: there RTDE and a program of our own stand in.
"""

from typing import Protocol, Self

from koala3d.capture.drivers.errors import NotReady, RigConnectionError
from koala3d.capture.drivers.ur.client import ClientChoice
from koala3d.capture.drivers.ur.interfaces.dashboard import Dashboard
from koala3d.capture.drivers.ur.modes import may_move
from koala3d.capture.drivers.ur.stand_in import StandIn

BUSY = ("PLAYING", "PAUSED")
"""States of a program that somebody may want to go on."""


class Pendant(Protocol):
    """A connection; every call has a deadline and raises RigConnectionError where no answer comes."""

    name: str

    @classmethod
    def connect(cls, host: str) -> Self:
        """Open the connection."""
        ...

    def stop(self) -> str:
        """End the program; "Stopped" where that was done, else why not."""
        ...

    def program_state(self) -> str:
        """ "PLAYING", "PAUSED" or "STOPPED", and behind it the program's name where it is known."""
        ...

    def safety_status(self) -> str:
        """ "NORMAL", "PROTECTIVE_STOP", "ROBOT_EMERGENCY_STOP", ..."""
        ...

    def robot_mode(self) -> str:
        """ "RUNNING", "IDLE", "POWER_OFF", ..."""
        ...

    def remote_control(self) -> bool:
        """Whether other computers may control the arm, as far as that can be asked."""
        ...

    def serial(self) -> str:
        """Serial number of the arm, or "unknown"."""
        ...

    def version(self) -> str:
        """Software version of the controller, "5.11.5.1010327", or "unknown"."""
        ...

    def close(self) -> None:
        """Close the connection; may be called twice."""
        ...


def connect(host: str) -> Pendant:
    """The dashboard where there is one, else what stands in for it. Raises RigConnectionError: no controller answers there."""
    try:
        return Dashboard.connect(host)
    except RigConnectionError as missing:
        try:
            return StandIn.connect(host)
        except RigConnectionError:
            raise missing from None


def require_ready(pendant: Pendant, host: str) -> None:
    """Raise NotReady unless the arm could move now."""
    safety, mode = pendant.safety_status(), pendant.robot_mode()
    if not may_move(safety):
        remedy = "find the cause, release it at the pendant, then run again"
        raise NotReady("the robot is stopped for safety", where=host, why=f"safety status {safety}", remedy=remedy)
    if mode != "RUNNING":
        remedy = "switch the arm on and release the brakes at the pendant"
        raise NotReady("the robot is not running", where=host, why=f"robot mode {mode}", remedy=remedy)
    if not pendant.remote_control():
        raise NotReady("the robot is in local control", where=host, remedy="choose remote control at the pendant")


def client_for(pendant: Pendant, choice: ClientChoice, host: str) -> ClientChoice:
    """The client that can be used. Raises NotReady: the vendor's is asked for, and there is no dashboard, which it needs."""
    if pendant.name == Dashboard.name:
        return choice
    if choice is ClientChoice.UR_RTDE:
        why = "PolyScope X has none, PolyScope 5 under Settings > Security > Services"
        raise NotReady("ur_rtde needs the dashboard server", where=host, why=why, remedy="use robot.client: koala")
    return ClientChoice.KOALA
