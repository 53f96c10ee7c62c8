"""A turntable on a stepper controller with Grbl 1.1, over a serial port or a network connection to one.

Grbl (github.com/gnea/grbl, wiki pages "Grbl v1.1 Interface" and "Grbl v1.1 Jogging") answers each line with `ok` or `error:N`,
and the single byte `?` with a status report such as `<Idle|MPos:90.000,0.000,0.000|FS:0,0>`. The table turns by jogs
(`$J=`), which the byte 0x85 ends at any time without an alarm and without losing the position.
"""

import re
import threading
import time
from collections.abc import Callable
from typing import Any, Self

import numpy as np

from koala3d.capture.drivers.errors import MotionError, NotReady, RigConnectionError, SafetyError, StopLatched
from koala3d.capture.drivers.turntable.wire import Wire
from koala3d.capture.model.turntable import TurntableDescription
from koala3d.datasets.core.console import hint

CANCEL = b"\x85"
AWAKE_S = 5.0  # an Arduino starts again when its port is opened, which takes two seconds
ANSWER_S = 2.0
HOMING_S = 120.0
POLL_S = 0.02
SPARE_S = 5.0  # of a motion, beyond one and a half times what it should take
NEAR_RAD = float(np.radians(0.05))  # a step of a motor with 200 steps, undivided, over a gear of 36
_STATUS = re.compile(r"^<(?P<state>[A-Za-z]+)(?::\d+)?\|MPos:(?P<places>[-\d.,]+)")


class GrblTurntable:
    """Implements `capture.drivers.protocols.Turntable`. The constructor touches nothing; entering connects or nothing is open.

    Leaving without an error turns the table back to zero, since a controller that starts again takes its place for zero.
    """

    def __init__(self, table: TurntableDescription) -> None:
        self.table, self._wire = table, Wire(table.address, table.baud)
        self._version, self._stopped = "", threading.Event()
        self._asking, self._away = threading.Lock(), False
        self._unit = 2 * np.pi / table.units_per_turn * (-1.0 if table.reversed else 1.0)

    def __enter__(self) -> Self:
        self._wire.open()
        try:
            state, _ = self._wake()
            self._version = next((line for line in self._command("$I") if line.startswith("[VER:")), "")
            if not self._version.startswith("[VER:1.1"):
                raise NotReady("the turntable's controller is not Grbl 1.1", where=self.table.address, why=self._version)
            if self.table.homing:
                self._command("$H", HOMING_S)
                state, _ = self._status()
            self._require_idle(state)
        except BaseException:
            self._wire.close()
            raise
        self._stopped.clear()
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if exception and exception[0] is not None:
                self._leave_in_place()
            elif not self._stopped.is_set():
                self.turn_to(0.0)
        finally:
            self._wire.close()

    def turn_to(self, angle: float) -> None:
        """See `Turntable`. Raises SafetyError, StopLatched, MotionError or RigConnectionError."""
        if beyond := self.table.outside(angle):
            remedy = "change the angles of the trajectory, or turntable.min_deg and max_deg in the rig file"
            raise SafetyError("the turntable may not turn there", why=beyond, remedy=remedy)
        if self._stopped.is_set():
            raise StopLatched("the turntable was stopped on request", where=self.table.address, remedy="connect again")
        self._away = angle != 0.0
        try:
            before = self.angle()
            speed = self.table.max_speed / abs(self._unit) * 60
            self._command(f"$J=G90 G21 G53 {self.table.letter}{angle / self._unit:.4f} F{speed:.2f}")
            self._arrive(angle, 1.5 * abs(angle - before) / self.table.max_speed + SPARE_S)
        except BaseException:
            self.stop()
            raise
        time.sleep(self.table.settle_time_s)

    def _arrive(self, angle: float, patience_s: float) -> None:
        deadline = time.monotonic() + patience_s
        while True:
            state, now = self._status()
            if self._stopped.is_set():
                raise MotionError("the turntable was stopped on request", where=self.table.address)
            if state == "Idle" and abs(now - angle) < NEAR_RAD:
                return
            left = f"it is at {np.degrees(now):.2f} degrees, {np.degrees(abs(angle - now)):.2f} from its target, in state {state}"
            if state not in ("Jog", "Idle", "Run"):
                remedy = "see what holds it; then switch the controller off and on"
                raise MotionError("the turntable stopped by itself", where=self.table.address, why=left, remedy=remedy)
            if time.monotonic() > deadline:
                remedy = "look for what blocks it, or lower turntable.max_speed"
                raise MotionError("the turntable does not arrive", where=self.table.address, why=left, remedy=remedy)
            time.sleep(POLL_S)

    def angle(self) -> float:
        """See `Turntable`."""
        return self._status()[1]

    def stop(self) -> None:
        """See `Turntable`; nothing turns until it is connected again."""
        self._stopped.set()
        try:
            self._wire.send(CANCEL)
        except RigConnectionError:
            hint(f"the turntable at {self.table.address} cannot be reached; its motion ends where it was going")

    def description(self) -> dict[str, Any]:
        """See `Turntable`."""
        return {"driver": "grbl", "address": self.table.address, "version": self._version, "homing": self.table.homing}

    def _leave_in_place(self) -> None:
        """Stop, and say where the table stands: a controller without homing switch may take that for zero from now on."""
        self.stop()
        if self._away and not self.table.homing:
            hint("the turntable is left where it stands; without a homing switch turn it to its mark before --resume")

    def _wake(self) -> tuple[str, float]:
        """The first status of the controller, which may have started again."""
        deadline, found = time.monotonic() + AWAKE_S, "nothing"
        while time.monotonic() < deadline:
            self._wire.send(b"?")
            until = time.monotonic() + 0.25
            while (line := self._wire.line(until - time.monotonic())) is not None:
                found = line
                if line.startswith("<"):
                    return self._read(line)
        remedy = "check turntable.address and baud; the controller must run Grbl 1.1"
        raise RigConnectionError("the turntable does not answer", where=self.table.address, why=f"it sent {found}", remedy=remedy)

    def _status(self) -> tuple[str, float]:
        """State of the controller and angle [rad], of this moment."""
        with self._asking:
            self._wire.send(b"?")
            line = self._next(ANSWER_S, "a status report", lambda text: text.startswith("<"))
        return self._read(line)

    def _read(self, line: str) -> tuple[str, float]:
        found = _STATUS.match(line)
        if found is None:
            remedy = "let the controller report machine positions: send it $10=1"
            raise NotReady("the turntable's status is not understood", where=self.table.address, why=line, remedy=remedy)
        try:
            place = float(found["places"].split(",")["XYZ".index(self.table.letter)])
        except (ValueError, IndexError):
            remedy = "check turntable.letter"
            raise NotReady("the turntable has no such axis", where=self.table.address, why=line, remedy=remedy) from None
        return found["state"], float(place * self._unit)

    def _command(self, text: str, timeout_s: float = ANSWER_S) -> list[str]:
        """Send a line and wait for its `ok`; the lines before it. Raises MotionError where the controller refuses."""
        with self._asking:
            self._wire.send(text.encode("ascii") + b"\n")
            lines: list[str] = []
            while True:
                line = self._next(timeout_s, f"an answer to {text}", lambda text: not text.startswith("<"))
                if line == "ok":
                    return lines
                if line.startswith(("error:", "ALARM:")):
                    remedy = "Grbl's documentation lists the numbers; the table stands still"
                    raise MotionError(f"the turntable refuses {text}", where=self.table.address, why=line, remedy=remedy)
                lines.append(line)

    def _next(self, timeout_s: float, wanted: str, fits: Callable[[str], bool]) -> str:
        deadline = time.monotonic() + timeout_s
        while (line := self._wire.line(deadline - time.monotonic())) is not None:
            if fits(line):
                return line
        remedy = "check cable and power; the same command with --resume continues"
        raise RigConnectionError(
            "the turntable went silent", where=self.table.address, why=f"there is not {wanted}", remedy=remedy
        )

    def _require_idle(self, state: str) -> None:
        if state != "Idle":
            remedy = "find out why; unlock the controller with $X, or home it with $H"
            raise NotReady("the turntable is not ready", where=self.table.address, why=f"state {state}", remedy=remedy)
