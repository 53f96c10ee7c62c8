"""A plain client of the UR dashboard server with a deadline on every call. It can stop the arm when everything else hangs."""

import re
import socket
from typing import Self

from koala3d.capture.drivers.errors import RigConnectionError

PORT, TIMEOUT_S = 29999, 1.0


class Dashboard:
    """One connection; `connect` opens it, `close` may be called twice."""

    name = "dashboard"

    def __init__(self, link: socket.socket, host: str) -> None:
        self.link, self.host = link, host
        self._buffer = b""

    @classmethod
    def connect(cls, host: str) -> Self:
        """Open the connection and read the greeting. Raises RigConnectionError: no UR controller answers there."""
        try:
            link = socket.create_connection((host, PORT), TIMEOUT_S)
        except OSError as error:
            why, remedy = error.strerror or str(error), "check that it is switched on, the cable, and robot.host in the rig file"
            raise RigConnectionError(
                "the robot's controller cannot be reached", where=f"{host}:{PORT}", why=why, remedy=remedy
            ) from None
        link.settimeout(TIMEOUT_S)
        dashboard = cls(link, host)
        try:
            greeting = dashboard._line()
            if "Dashboard" not in greeting:
                raise RigConnectionError("not a UR dashboard server", where=f"{host}:{PORT}", why=f"it answers {greeting!r}")
        except RigConnectionError:
            dashboard.close()
            raise
        return dashboard

    def ask(self, command: str) -> str:
        """Reply to one command. Raises RigConnectionError: no reply within a second."""
        try:
            self.link.sendall(f"{command}\n".encode())
        except OSError as error:
            raise self._lost(command, error) from None
        return self._line(command)

    def version(self) -> str:
        """Software version of the controller, "5.11.5.1010327"."""
        found = re.search(r"\d+(\.\d+)+", self.ask("PolyscopeVersion"))
        return found[0] if found else "unknown"

    def safety_status(self) -> str:
        """ "NORMAL", "PROTECTIVE_STOP", "ROBOT_EMERGENCY_STOP", ..."""
        return self.ask("safetystatus").partition(":")[2].strip()

    def robot_mode(self) -> str:
        """ "RUNNING", "IDLE", "POWER_OFF", ..."""
        return self.ask("robotmode").partition(":")[2].strip()

    def program_state(self) -> str:
        """ "PLAYING palletizing.urp", "PAUSED ...", "STOPPED ..."."""
        return self.ask("programState")

    def remote_control(self) -> bool:
        """Whether the pendant has handed over control."""
        return "true" in self.ask("is in remote control").lower()

    def stop(self) -> str:
        """End the program; "Stopped" where that was done."""
        return self.ask("stop")

    def serial(self) -> str:
        """Serial number of the arm."""
        return self.ask("get serial number")

    def close(self) -> None:
        """Close the connection."""
        self.link.close()

    def _line(self, command: str = "greeting") -> str:
        while b"\n" not in self._buffer:
            try:
                chunk = self.link.recv(4096)
            except OSError as error:
                raise self._lost(command, error) from None
            if not chunk:
                raise self._lost(command, ConnectionError("it closed the connection"))
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode("latin-1").strip()

    def _lost(self, command: str, error: OSError) -> RigConnectionError:
        self.close()  # a late reply must not be taken as the answer to the next command
        why, remedy = f"{command}: {error}", "check the network; the arm stops by its own watchdog"
        return RigConnectionError("the dashboard server does not answer", where=f"{self.host}:{PORT}", why=why, remedy=remedy)
