"""What a person reads after a fault of the arm, by what is known of the controller then."""

from dataclasses import dataclass

from koala3d.capture.drivers.errors import CaptureError, ConnectionLapse, NotReady, ProtectiveStop, RigConnectionError
from koala3d.capture.drivers.ur.client import StartFailure, is_vendors
from koala3d.capture.drivers.ur.modes import is_guarded, may_move
from koala3d.capture.drivers.ur.stop_channel import StopReply


@dataclass(frozen=True)
class Aftermath:
    """What is known after the arm was ordered to stop."""

    host: str
    answer: StopReply
    known: str
    """Of the stop and of the arm's motion, in words."""
    safety: str
    """Safety status by its name; empty: the controller does not answer."""
    mode: str

    def error(self, what: str, kind: type[CaptureError], remedy: str) -> CaptureError:
        """The error for a fault; of `kind` unless the controller knows more."""
        if self.safety == "PROTECTIVE_STOP":
            remedy = "do what docs/recovery.md says: find the cause, release the stop at the pendant, resume slowly"
            return ProtectiveStop("protective stop: the arm stands still", where=self.host, why=what, remedy=remedy)
        if self.safety and not may_move(self.safety):
            remedy = "release it at the pendant, switch the arm on, then resume"
            if is_guarded(self.safety):
                remedy = "close the fence or reset the scanner; the program was ended and does not go on by itself; then resume"
            why = f"safety status {self.safety}, robot mode {self.mode}"
            return NotReady("the robot is stopped for safety", where=self.host, why=why, remedy=remedy)
        if self.answer is StopReply.SILENT:
            kind, remedy = RigConnectionError, "the arm stops by its own watchdog; check network and controller, then resume"
        elif self.answer in (StopReply.REFUSED, StopReply.UNCONFIRMED):
            remedy = "press the emergency stop, then see at the pendant what its program does"
        elif kind is RigConnectionError and self.safety:
            kind = ConnectionLapse
        return kind(what, where=self.host, why=self.known, remedy=remedy)


def start_remedy(failure: StartFailure, client: str, registers: str) -> str:
    """What to do about a client that did not start; `registers` as the rig file chooses them."""
    if failure is StartFailure.MISSING:
        return "pip install 'koala-capture[robot]', or use robot.client: koala"
    if failure is not StartFailure.IN_USE:
        return "check the controller, then run again"
    is_lower = is_vendors(client) and registers == "lower"
    other = "robot.registers: upper" if is_lower else "robot.client: ur_rtde and robot.registers: lower"
    taken = "0 to 23" if is_lower else "24 to 47"
    return f"end the other program that controls the robot; if a fieldbus owns the registers {taken}, use {other}"
