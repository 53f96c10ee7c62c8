"""A simulated stepper controller with Grbl 1.1, on a network port or a pseudo-terminal. It turns one axis.

It knows the part of the protocol that `capture.drivers.turntable.grbl` lists, the lock of an alarm (`$X`) and homing (`$H`).
"""

import os
import re
import select
import socket
import threading
import time
from functools import partial
from typing import Self

import numpy as np

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
ACCELERATION = 200.0  # units/s^2
STEPS_PER_UNIT = 80.0  # positions are whole steps, as reported
_JOG = re.compile(r"^\$J=(?:G90|G21|G53|\s)*(?P<letter>[XYZ])(?P<place>-?[\d.]+)\s*F(?P<speed>[\d.]+)$")


class SimulatedGrbl:
    """The controller, in a thread. Use as a context manager; `address` is then what a rig file gives.

    Args:
        time_scale: speed of its motions relative to real time.
        terminal: listen at a pseudo-terminal, as a serial port, in place of a port of this computer.
        state: the state in which it begins, "Idle" or "Alarm".
    """

    def __init__(self, *, time_scale: float = 1.0, terminal: bool = False, state: str = "Idle") -> None:
        self.time_scale, self.address = time_scale, ""
        self._terminal, self.state, self._lock = terminal, state, threading.Lock()
        self._from, self._to, self._speed, self._began = 0.0, 0.0, 1.0, time.monotonic()
        self.silent, self.stuck = False, False
        self._ends: list[int] = []
        self._closing = threading.Event()

    def __enter__(self) -> Self:
        self._closing.clear()
        if self._terminal:
            ours, theirs = os.openpty()
            self._ends, self.address = [ours, theirs], os.ttyname(theirs)
            work = partial(self._serve, ours)
        else:
            listening = socket.create_server(("127.0.0.1", 0))
            listening.settimeout(0.1)
            self.address = f"127.0.0.1:{listening.getsockname()[1]}"
            work = partial(self._listen, listening)
        self._thread = threading.Thread(target=work, name="simulated Grbl", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing.set()
        self._thread.join()
        for end in self._ends:
            os.close(end)
        self._ends = []

    @property
    def place(self) -> float:
        """Position of the axis now [units], in whole steps."""
        with self._lock:
            return self._place()

    def _place(self) -> float:
        """The same, with a trapezoidal speed profile from where the motion began."""
        away = self._to - self._from
        seconds = (time.monotonic() - self._began) * self.time_scale
        if self.stuck:
            return self._from
        distance, ramp_s = abs(away), min(self._speed / ACCELERATION, float(np.sqrt(abs(away) / ACCELERATION)))
        top = ramp_s * ACCELERATION
        total_s = 0.0 if not distance else 2 * ramp_s + (distance - top * ramp_s) / top
        left_s = max(total_s - seconds, 0.0)
        if seconds < ramp_s:
            gone = 0.5 * ACCELERATION * seconds**2
        elif left_s < ramp_s:
            gone = distance - 0.5 * ACCELERATION * left_s**2
        else:
            gone = 0.5 * top * ramp_s + top * (seconds - ramp_s)
        return round((self._from + float(np.sign(away)) * gone) * STEPS_PER_UNIT) / STEPS_PER_UNIT

    def _listen(self, listening: socket.socket) -> None:
        with listening:
            while not self._closing.is_set():
                try:
                    client, _ = listening.accept()
                except TimeoutError:
                    continue
                with client:
                    self._serve(client.fileno())

    def _serve(self, descriptor: int) -> None:
        """Answer one client until it hangs up."""
        line = b""
        try:
            os.write(descriptor, BANNER)
            while not self._closing.is_set():
                if not select.select([descriptor], [], [], 0.05)[0]:
                    continue
                data = os.read(descriptor, 256)
                if not data:
                    return
                for one in (data[i : i + 1] for i in range(len(data))):
                    if one in (b"?", b"\x85", b"!", b"\x18"):
                        self._answer(descriptor, self._at_once(one))
                    elif one in b"\r\n":
                        self._answer(descriptor, self._reply(line.decode("ascii", "replace")) if line else b"")
                        line = b""
                    else:
                        line += one
        except OSError:
            return  # the client is gone

    def _answer(self, descriptor: int, text: bytes) -> None:
        if text and not self.silent:
            os.write(descriptor, text)

    def _at_once(self, byte: bytes) -> bytes:
        """What a real-time command does, and its answer."""
        with self._lock:
            place = self._place()
            if byte == b"?":
                moving = self.state == "Idle" and place != round(self._to * STEPS_PER_UNIT) / STEPS_PER_UNIT
                return f"<{'Jog' if moving else self.state}|MPos:{place:.3f},0.000,0.000|FS:0,0>\r\n".encode()
            moving = place != self._to
            self._from = self._to = place
            if byte == b"\x18":
                self.state = "Alarm" if moving else self.state
                return BANNER
            return b""

    def _reply(self, text: str) -> bytes:
        with self._lock:
            if text in ("$X", "$H"):
                self.state = "Idle"
                if text == "$H":
                    self._from = self._to = 0.0
                return b"ok\r\n"
            if text == "$I":
                return b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n"
            if self.state != "Idle":
                return b"error:9\r\n"  # locked out during an alarm
            found = _JOG.match(text)
            if found is None:
                return b"error:20\r\n"  # unsupported command
            self._from, self._to = self._place(), float(found["place"])
            self._speed, self._began = float(found["speed"]) / 60, time.monotonic()
            return b"ok\r\n"
