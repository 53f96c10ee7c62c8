"""Stands in for the dashboard, which PolyScope X does not have: asks over RTDE, and stops the arm by a program of its own.

A program that arrives at the primary interface takes the place of the one that runs. This one brings the joints to rest and ends.
The Robot API, which PolyScope X has from 10.11 on, is asked for the rest, and is the second way to stop.
"""

import contextlib
import socket
import time
from typing import Any, Self

from koala3d.capture.drivers.errors import RigConnectionError
from koala3d.capture.drivers.ur.interfaces import primary, robot_api
from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode, name_of
from koala3d.capture.drivers.ur.rtde.stream import RtdeStream

RATE_HZ, TIMEOUT_S = 50.0, 1.0
STOP_S = 2.0  # until the arm rests: joints that turn at 2 rad/s slow down at 3 rad/s^2
STOP = "def koala_stop():\n  stopj(3.0)\nend\n"
STATES = {2: "PLAYING", 3: "PAUSED", 4: "PAUSED", 5: "PLAYING"}
"""The dashboard's words for numbers in `runtime_state`: playing, pausing, paused and resuming. Others are "STOPPED"."""


def program_state(runtime_state: int) -> str:
    """What the program does, in the dashboard's words."""
    return STATES.get(runtime_state, "STOPPED")


def runtime_state(host: str) -> str:
    """What the program does by RTDE, in the dashboard's words; empty: RTDE does not answer."""
    try:
        return program_state(_sample(host)["runtime_state"])
    except RigConnectionError:
        return ""


class StandIn:
    """A `Pendant` of a controller without dashboard.

    Without a Robot API nobody says whether the controller takes orders from other computers, nor the arm's serial number.
    """

    name = "primary interface"

    def __init__(self, host: str, version: tuple[int, ...]) -> None:
        self.host, self._version, self._api = host, version, robot_api.ask(host)

    @classmethod
    def connect(cls, host: str) -> Self:
        """Ask once. Raises RigConnectionError: RTDE or the primary interface does not answer."""
        try:
            version = primary.listen(host, TIMEOUT_S).version
        except (OSError, ValueError) as error:
            raise _silent(host, str(error)) from None
        if version is None:
            raise _silent(host, "the primary interface says nothing")
        found = cls(host, version)
        found.robot_mode()
        return found

    def stop(self) -> str:
        """End the program and wait until the arm rests; where the state is not known, the order is sent all the same."""
        with contextlib.suppress(RigConnectionError):
            if self.program_state() == "STOPPED":
                return "no program runs"
        try:
            with socket.create_connection((self.host, primary.PORT), TIMEOUT_S) as link:
                link.sendall(STOP.encode())
                deadline = time.monotonic() + STOP_S
                while time.monotonic() < deadline:
                    if self.program_state() == "STOPPED":
                        return "Stopped"
        except OSError as error:
            raise _silent(self.host, str(error)) from None
        if robot_api.stop(self.host) and self.program_state() == "STOPPED":
            return "Stopped"
        return "its program goes on"

    def program_state(self) -> str:
        """Of whatever runs; its name is not known here."""
        return program_state(self._now()["runtime_state"])

    def safety_status(self) -> str:
        """By the names of the dashboard."""
        return name_of(SafetyMode, self._now()["safety_mode"])

    def robot_mode(self) -> str:
        """By the names of the dashboard."""
        return name_of(RobotMode, self._now()["robot_mode"])

    def remote_control(self) -> bool:
        """As the Robot API says it. Without one the control program does not start in local control, and that is reported."""
        api = self._api = robot_api.ask(self.host) if self._api else None
        return api is None or api.control_mode != "LOCAL"

    def serial(self) -> str:
        """As the Robot API says it."""
        return (self._api.serial if self._api else "") or "unknown"

    def version(self) -> str:
        """From the primary interface."""
        return ".".join(map(str, self._version))

    def close(self) -> None:
        """Nothing is open between two questions."""

    def _now(self) -> dict[str, Any]:
        return _sample(self.host)


def _sample(host: str) -> dict[str, Any]:
    """A sample of this moment, over a connection of its own: one that nobody reads for an hour fills up and is closed."""
    try:
        stream = RtdeStream(host, ["safety_mode", "robot_mode", "runtime_state"], [], RATE_HZ)
    except OSError as error:
        raise _silent(host, str(error)) from None
    try:
        sample = stream.newest(TIMEOUT_S)
    finally:
        stream.close()
    if sample is None:
        raise _silent(host, "no sample within a second")
    return sample


def _silent(host: str, why: str) -> RigConnectionError:
    remedy = "check the network; the arm stops by its own watchdog"
    return RigConnectionError("the controller does not answer", where=host, why=why, remedy=remedy)
