"""The process that holds the client of the controller: `python -m koala3d.capture.drivers.ur._child FD '{"host": ..., ...}'`.

The vendor's client can hang, hold the interpreter or crash when a connection breaks; the parent then kills this process. The two
exchange JSON lines over the socket FD. This one sends {"ready": ...} or {"failed": ...}, then {"state": ...} for every new sample
and {"accepted": number} or {"refused": number} for every motion. It receives {"do": "move" | "stop" | "watch" | "freedrive"}. It
ends with the socket.
"""

import contextlib
import json
import os
import select
import socket
import sys
import time
from typing import Any

from koala3d.capture.drivers.ur.client import Client, ClientChoice, StartError, StartFailure

MAX_BUSY_PERIOD_S, IDLE_PERIOD_S, BUSY_AFTER_S = 0.005, 0.02, 1.0
"""Periods of polling the client: in motion and for a while after it (at least twice per sample), and otherwise [s]."""
KICK_S = 0.05


PATIENCE_S = 1.0  # without the parent taking anything, until the arm is brought to rest [s]
NICENESS = -10
"""Priority where the user may raise it: a pause of the length of a deadline stops the arm, and this process needs little."""


def open_client(choice: str, host: str, frequency: float, watchdog_hz: float, registers: str) -> Client:
    """Connect and start the control program; it stops by itself when it is not kicked for 1 / `watchdog_hz` seconds.

    `registers`: see `capture.model.rig.RobotDescription`.

    Raises:
        StartError: it did not start.
        OSError: the controller cannot be reached.
    """
    if choice != ClientChoice.KOALA:
        try:
            from koala3d.capture.drivers.ur.vendor_client import VendorClient

            return VendorClient(host, frequency, watchdog_hz, upper=registers == "upper")
        except ImportError as error:
            if choice == ClientChoice.UR_RTDE:
                raise StartError(f"ur-rtde is not installed: {error}", StartFailure.MISSING) from None
    from koala3d.capture.drivers.ur.koala_client import KoalaClient

    return KoalaClient(host, frequency, watchdog_hz)


class Outbox:
    """Messages to the parent. None waits for it: the watchdog must be kicked while the parent is busy.

    A sample that finds the way blocked is dropped, since a newer one follows. Raises TimeoutError from `put` if the parent takes
    nothing for `PATIENCE_S`.
    """

    def __init__(self, link: socket.socket) -> None:
        self.link, self._waiting, self._blocked_since = link, b"", 0.0

    def put(self, message: dict[str, Any], *, may_drop: bool = False) -> None:
        """Send, or keep what cannot be sent yet."""
        self._send()
        if not (may_drop and self._waiting):
            self._waiting += (json.dumps(message) + "\n").encode()
            self._send()

    def _send(self) -> None:
        now = time.monotonic()
        try:
            while self._waiting:
                self._waiting = self._waiting[self.link.send(self._waiting) :]
                self._blocked_since = now
        except BlockingIOError:
            if now - self._blocked_since > PATIENCE_S:
                raise TimeoutError("the parent takes nothing") from None
        if not self._waiting:
            self._blocked_since = now


def _serve(client: Client, link: socket.socket, busy_period_s: float) -> None:
    """Loop until the link closes."""
    link.setblocking(False)
    outbox = Outbox(link)
    buffer, kicked, stamp, busy_until = b"", 0.0, -1.0, 0.0
    while True:
        begun = time.monotonic()
        try:
            chunk = link.recv(65536)
            if not chunk:
                return
            buffer += chunk
        except BlockingIOError:
            pass  # no request
        *lines, buffer = buffer.split(b"\n")
        for line in lines:
            busy_until = begun + BUSY_AFTER_S
            if answer := _obey(client, json.loads(line)):
                outbox.put(answer)
        if begun - kicked >= KICK_S:
            client.kick()
            kicked = begun
        state = client.state()
        busy_until = begun + BUSY_AFTER_S if state["moving"] else busy_until
        if state["robot_time_s"] != stamp or not (state["connected"] and state["running"]):
            stamp = state["robot_time_s"]
            outbox.put({"state": state}, may_drop=True)
        period = busy_period_s if begun < busy_until else IDLE_PERIOD_S
        select.select([link], [], [], max(0.0, period - (time.monotonic() - begun)))


def _obey(client: Client, request: dict[str, Any]) -> dict[str, Any] | None:
    if request["do"] == "watch":  # a request by itself makes samples come as in motion
        return None
    if request["do"] == "stop":
        client.stop(request["deceleration"])
        return {"stopping": request["number"]}
    if request["do"] == "freedrive":
        return {"freed" if client.freedrive(request["on"]) else "refused": request["number"]}
    before = client.move(request["joints"], request["speed"], request["acceleration"])
    return {"refused": request["number"]} if before is None else {"accepted": request["number"], "operation_before": before}


def _send(link: socket.socket, message: dict[str, Any]) -> None:
    link.settimeout(PATIENCE_S)
    link.sendall((json.dumps(message) + "\n").encode())


def main() -> None:
    """Connect, serve, and leave without the vendor's destructors, which sleep and may hang."""
    link = socket.socket(fileno=int(sys.argv[1]))
    options = json.loads(sys.argv[2])
    with contextlib.suppress(OSError):  # most users may not
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    try:
        client = open_client(**options)
        _send(link, {"ready": True, "tcp_offset": client.tcp_offset(), "client": client.name})
    except (RuntimeError, OSError) as error:
        failure = error.failure if isinstance(error, StartError) else StartFailure.OTHER
        with contextlib.suppress(OSError):
            _send(link, {"failed": str(error), "failure": failure})
        os._exit(1)
    with contextlib.suppress(OSError, KeyboardInterrupt):  # the parent has ended, or the whole group was interrupted
        _serve(client, link, min(MAX_BUSY_PERIOD_S, 0.5 / options["frequency"]))
        client.leave()
    os._exit(0)


if __name__ == "__main__":
    main()
