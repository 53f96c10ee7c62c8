"""A client of our own: what the driver needs of a UR controller, in plain sockets.

It sends the control program to the primary interface, then talks to it through RTDE registers; see `program` for their meaning.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

from koala3d.capture.drivers.ur.client import StartError, StartFailure, State, versioned
from koala3d.capture.drivers.ur.interfaces import primary
from koala3d.capture.drivers.ur.rtde import program
from koala3d.capture.drivers.ur.rtde.program import FIRST, Command
from koala3d.capture.drivers.ur.rtde.stream import RegistersInUse, RtdeStream

CONNECT_S, START_S, ANSWER_S = 2.0, 5.0, 1.0
"""Until the primary interface accepts, the program runs, and a command is carried out [s]."""
RUNNING = 2  # runtime state of a program that runs and is not paused
STATE_REGISTER, PROGRESS_REGISTER = f"output_int_register_{FIRST}", f"output_int_register_{FIRST + 2}"
RESULT_REGISTERS = [f"output_double_register_{FIRST + index}" for index in range(6)]
OUTPUTS = "timestamp actual_q actual_qd actual_TCP_pose safety_status_bits runtime_state target_speed_fraction".split()
OUTPUTS += ["joint_temperatures", STATE_REGISTER, PROGRESS_REGISTER, *RESULT_REGISTERS]
COMMAND_ONLY, WITH_ARGUMENTS = 1, 2
INPUTS = [
    [f"input_int_register_{FIRST}"],
    [*(f"input_double_register_{FIRST + i}" for i in range(8)), f"input_int_register_{FIRST + 1}", f"input_int_register_{FIRST}"],
]


class KoalaClient:
    """The connection and the running program. Takes one thread; no call waits for longer than `ANSWER_S` once it is made."""

    def __init__(self, host: str, frequency: float, watchdog_hz: float) -> None:
        self.name = versioned("koala", "koala-capture")
        try:
            self._stream = RtdeStream(host, OUTPUTS, INPUTS, frequency)
        except RegistersInUse as error:
            raise StartError(str(error), StartFailure.IN_USE) from None
        self._command, self._is_free = Command.NONE, False
        self._watchdog_hz = watchdog_hz
        self._sample: dict[str, Any] = {}
        self._start(host)

    def state(self) -> State:
        """The newest sample; that of last time where no other has arrived."""
        self._receive()
        sample, progress = self._sample, self._sample[PROGRESS_REGISTER]
        return {
            "robot_time_s": sample["timestamp"],
            "joints": sample["actual_q"],
            "joint_speeds": sample["actual_qd"],
            "tcp_pose": sample["actual_TCP_pose"],
            "joint_temperatures": sample["joint_temperatures"],
            "speed_fraction": sample["target_speed_fraction"],
            "safety_bits": sample["safety_status_bits"],
            "connected": self._stream.connected,
            "running": self._running,
            "operation": progress >> 24 & 127,
            "moving": bool(progress & program.RUNNING_BIT),
            "host_time_ns": time.monotonic_ns(),
        }

    def move(self, joints: Sequence[float], speed: float, acceleration: float) -> int | None:
        """Start a motion; the number of the one before, or None where the controller did not take it."""
        before = self.state()["operation"]
        return before if self._order(Command.MOVE, [*joints, speed, acceleration]) and self._done(ANSWER_S) else None

    def stop(self, deceleration: float) -> None:
        """Bring the arm to rest; returns at once."""
        if self._is_free:
            self.freedrive(False)
        self._order(Command.STOP, [deceleration])

    def freedrive(self, on: bool) -> bool:
        """Let a person move the arm by hand, or hold it; whether the controller did so."""
        done = self._order(Command.TEACH if on else Command.END_TEACH) and self._done(ANSWER_S)
        self._is_free = on if done else self._is_free
        return done

    def kick(self) -> None:
        """Show the watchdog that somebody is there, by writing the command register once more."""
        self._stream.send(COMMAND_ONLY, [self._command])

    def tcp_offset(self) -> list[float]:
        """(6,) position [m] and rotation vector [rad] of the tool in the flange; empty where it cannot be read."""
        if not (self._order(Command.TCP_OFFSET) and self._done(ANSWER_S)):
            return []
        return [float(self._sample[name]) for name in RESULT_REGISTERS]

    def leave(self) -> None:
        """Bring the arm to rest and close the connection, once the controller has read the order."""
        self.stop(2.0)
        self._done(ANSWER_S)
        self._stream.close()

    @property
    def _running(self) -> bool:
        return self._sample["runtime_state"] == RUNNING

    def _start(self, host: str) -> None:
        """Send the program and wait until it takes commands; the registers may still hold what an earlier client left."""
        deadline = time.monotonic() + START_S
        self._wait(lambda: not self._running, deadline, "another program runs on the controller and does not end")
        self.kick()
        try:
            with primary.Upload(host, program.text(), CONNECT_S) as upload:
                otherwise = "connected, but the control program does not run"
                self._wait(lambda: self._running and self._ready, deadline, otherwise, upload.refusal)
        except (OSError, ValueError) as error:
            why = f"port {primary.PORT} takes no program: {error}"
            raise StartError(f"{why}; open 'Primary/Secondary' in the security settings of the pendant") from None
        if not (self._order(Command.WATCHDOG, [self._watchdog_hz]) and self._done(ANSWER_S)):
            raise StartError("the controller refused the watchdog")

    def _wait(
        self, happened: Callable[[], bool], deadline: float, otherwise: str, refusal: Callable[[], str] = lambda: ""
    ) -> None:
        while not (self._sample and happened()):
            self._receive(0.02)
            if not self._stream.connected:
                raise StartError("the controller closed the connection")
            if refused := refusal():
                raise StartError(f"the controller refuses the control program: {refused}")
            if time.monotonic() > deadline:
                raise StartError(otherwise)

    @property
    def _ready(self) -> bool:
        return self._sample[STATE_REGISTER] == program.READY

    def _receive(self, wait_s: float = 0.0) -> None:
        """Take over the newest sample; take back a command that has been carried out."""
        self._sample = self._stream.newest(wait_s) or self._sample
        if self._command and self._sample[STATE_REGISTER] == program.DONE:
            self._command = Command.NONE
            self.kick()

    def _order(self, command: Command, arguments: list[float] | None = None) -> bool:
        """Send a command once the program is ready; whether it was sent."""
        if not self._until(lambda: not self._command and self._ready):
            return False
        self._command = command
        numbers = [*(arguments or []), *[0.0] * 8][:8]
        self._stream.send(WITH_ARGUMENTS, [*numbers, 1, command])
        return self._stream.connected

    def _done(self, timeout_s: float) -> bool:
        """Whether the command was carried out in time."""
        return self._until(lambda: not self._command, timeout_s)

    def _until(self, happened: Callable[[], bool], timeout_s: float = ANSWER_S) -> bool:
        """Whether it happened in time, the connection and the program being alive; the watchdog is kicked meanwhile."""
        deadline = time.monotonic() + timeout_s
        while True:
            self._receive()
            if not (self._stream.connected and self._running):
                return False
            if happened():
                return True
            if time.monotonic() > deadline:
                return False
            self.kick()
            self._receive(0.01)
