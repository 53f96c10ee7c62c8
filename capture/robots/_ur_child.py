"""The process that holds the vendor's client: `python -m capture.robots._ur_child FD '{"host": ..., ...}'`.

The client can hang, hold the interpreter or crash when a connection breaks; here it may, and the parent kills it. Speaks
JSON lines over the socket FD. It says {"ready": ...} or {"failed": ...}, then {"state": ...} for every new sample and
{"accepted": id} or {"refused": why} for every motion. It hears {"do": "move" | "stop"}, and ends when the socket closes.
"""

import contextlib
import json
import os
import select
import socket
import sys
import time
from typing import Any

MAX_BUSY_PERIOD_S, IDLE_PERIOD_S, BUSY_AFTER_S = 0.005, 0.02, 1.0
"""The client is asked this often in motion and for a while after it (or at twice its frequency, so that no state waits for more than
half a period), and else [s]."""
KICK_S = 0.05
VARIABLES = [
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "robot_mode",
    "safety_mode",
    "safety_status_bits",
    "runtime_state",
    "target_speed_fraction",
]


class _Client:
    """Both connections of the vendor's library."""

    def __init__(self, host: str, frequency: float, watchdog_hz: float) -> None:
        from rtde_control import RTDEControlInterface
        from rtde_receive import RTDEReceiveInterface

        self.receive = RTDEReceiveInterface(host, frequency, VARIABLES)
        self.control = RTDEControlInterface(host, frequency)
        deadline = time.monotonic() + 2.0
        while not (self.receive.isConnected() and self.control.isConnected() and self.control.isProgramRunning()):
            if time.monotonic() > deadline:
                raise RuntimeError("connected, but the control program does not run")
            time.sleep(0.01)
        if not self.control.setWatchdog(watchdog_hz):
            raise RuntimeError("the controller refused the watchdog")

    def state(self) -> dict[str, Any]:
        """The newest sample, and whether everything is as it must be."""
        operation = self.control.getAsyncOperationProgressEx()
        return {
            "robot_time_s": self.receive.getTimestamp(),
            "joints": self.receive.getActualQ(),
            "joint_speeds": self.receive.getActualQd(),
            "tcp_pose": self.receive.getActualTCPPose(),
            "speed_fraction": self.receive.getTargetSpeedFraction(),
            "safety_bits": self.receive.getSafetyStatusBits(),
            "connected": self.receive.isConnected() and self.control.isConnected(),
            "running": self.control.isProgramRunning(),
            "operation": operation.operationId(),
            "moving": operation.isAsyncOperationRunning(),
            "host_time_ns": time.monotonic_ns(),
        }


def _serve(client: _Client, link: socket.socket, busy_period_s: float) -> None:
    """Loop until the link closes; then slow the arm down."""
    link.setblocking(False)
    buffer, kicked, stamp, busy_until = b"", 0.0, -1.0, 0.0
    while True:
        begun = time.monotonic()
        try:
            chunk = link.recv(65536)
            if not chunk:
                break
            buffer += chunk
        except BlockingIOError:
            pass  # nothing was asked
        *lines, buffer = buffer.split(b"\n")
        for line in lines:
            busy_until = begun + BUSY_AFTER_S
            _say(link, _obey(client, json.loads(line)))
        if begun - kicked >= KICK_S:
            client.control.kickWatchdog()
            kicked = begun
        state = client.state()
        busy_until = begun + BUSY_AFTER_S if state["moving"] else busy_until
        if state["robot_time_s"] != stamp or not (state["connected"] and state["running"]):
            stamp = state["robot_time_s"]
            _say(link, {"state": state})
        period = busy_period_s if begun < busy_until else IDLE_PERIOD_S
        select.select([link], [], [], max(0.0, period - (time.monotonic() - begun)))
    client.control.stopJ(2.0, True)


def _obey(client: _Client, request: dict[str, Any]) -> dict[str, Any]:
    if request["do"] == "stop":
        client.control.stopJ(request["deceleration"], True)
        return {"stopping": request["number"]}
    before = client.control.getAsyncOperationProgressEx().operationId()
    if client.control.moveJ(request["joints"], request["speed"], request["acceleration"], True):
        return {"accepted": request["number"], "operation_before": before}
    return {"refused": request["number"]}


def _say(link: socket.socket, message: dict[str, Any]) -> None:
    link.setblocking(True)
    link.settimeout(1.0)
    link.sendall((json.dumps(message) + "\n").encode())
    link.setblocking(False)


def main() -> None:
    """Connect, serve, and leave without the library's destructors, which sleep and may hang."""
    link = socket.socket(fileno=int(sys.argv[1]))
    options = json.loads(sys.argv[2])
    try:
        client = _Client(**options)
        _say(link, {"ready": True, "tcp_offset": client.control.getTCPOffset()})
    except (RuntimeError, OSError) as error:
        with contextlib.suppress(OSError):
            _say(link, {"failed": str(error)})
        os._exit(1)
    with contextlib.suppress(OSError, KeyboardInterrupt):  # the parent has gone, or the whole group was interrupted
        _serve(client, link, min(MAX_BUSY_PERIOD_S, 0.5 / options["frequency"]))
    os._exit(0)


if __name__ == "__main__":
    main()
