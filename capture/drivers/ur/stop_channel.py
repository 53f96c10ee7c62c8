"""Stops the arm over a connection that answers when every other one hangs, and says what is known of the arm then."""

import threading
import time
from collections.abc import Callable
from enum import Enum

import numpy as np

from koala3d.capture.drivers.errors import NotReady, RigConnectionError
from koala3d.capture.drivers.ur import pendant
from koala3d.capture.drivers.ur.link import Sample
from koala3d.capture.drivers.ur.pendant import BUSY, Pendant
from koala3d.capture.drivers.ur.stand_in import runtime_state

STILL_RAD_S = 0.01
"""Below this speed of its fastest joint an arm counts as at rest [rad/s]: ten times the noise of measured speeds."""


class StopReply(Enum):
    """What became of an order to stop."""

    STOPPED = "the arm was stopped"
    IDLE = "the controller runs no program"
    REFUSED = "the controller refused to stop its program, which still runs"
    UNCONFIRMED = "the controller stopped no program, and nothing confirms that none runs"
    SILENT = "the controller does not answer a second connection either"


class StopChannel:
    """A second connection to the controller, through which any thread may stop the arm when the first one hangs."""

    def __init__(self, host: str) -> None:
        self.host = host
        self.pendant: Pendant | None = None
        self._open: Callable[[str], Pendant] = pendant.connect
        self.reply = ""  # the controller's words if it refused
        self._ours = False  # whether a program that runs may be ended on leaving
        self._lock = threading.Lock()

    def connect(self) -> Pendant:
        """Open the connection. Raises RigConnectionError: no UR controller answers there."""
        self.pendant = controller = self._open(self.host)
        self._open = type(controller).connect  # which of the two it is does not change
        return controller

    def take(self, patience_s: float, *, by_force: bool) -> None:
        """End what a killed client has left; it would block the next client for minutes.

        Raises NotReady: a program still runs or is paused after `patience_s`, in which the watchdog ends a killed client's. It
        is left alone, also on `release`, unless `by_force`.
        """
        controller, deadline = self.pendant or self.connect(), time.monotonic() + patience_s
        while not by_force and (state := controller.program_state()).startswith(BUSY):
            if time.monotonic() > deadline:
                remedy = "wait for it, stop it at the pendant, or take over: 'capture run --take-over' ends it"
                raise NotReady("a program runs on the robot and was left alone", where=self.host, why=state, remedy=remedy)
            time.sleep(0.05)
        self._ours = True
        controller.stop()

    def stop(self) -> StopReply:
        """Order the controller to end its program; tries again over a new connection. Only the reply "Stopped" is a stop.

        After any other reply RTDE is asked as well: the dashboard need not know of a program that was uploaded.
        """
        with self._lock:
            for attempt in range(2):
                try:
                    controller = self.connect() if attempt or self.pendant is None else self.pendant
                    self.reply = controller.stop()
                    if self.reply == "Stopped":
                        return StopReply.STOPPED
                    states = controller.program_state(), runtime_state(self.host)
                    if any(state.startswith(BUSY) for state in states):
                        return StopReply.REFUSED
                    return StopReply.IDLE if states[1] else StopReply.UNCONFIRMED
                except RigConnectionError:
                    continue
        return StopReply.SILENT

    def safety_and_mode(self) -> tuple[str, str]:
        """What the controller says of them; empty where it does not answer."""
        try:
            return (self.pendant.safety_status(), self.pendant.robot_mode()) if self.pendant else ("", "")
        except RigConnectionError:
            return "", ""

    def release(self) -> None:
        """End the program, if it is ours, and close the connection; may be called twice."""
        (controller, self.pendant), (ours, self._ours) = (self.pendant, None), (self._ours, False)
        if controller is not None:
            try:
                if ours:
                    controller.stop()
            except RigConnectionError:
                return  # unreachable: the watchdog ends the program
            finally:
                controller.close()

    def known(self, answer: StopReply, sample: Sample | None) -> str:
        """What is known of the arm after an order to stop, in words; `sample` is the newest one."""
        if answer is StopReply.STOPPED:
            return answer.value
        refused = answer in (StopReply.REFUSED, StopReply.UNCONFIRMED)
        refusal = f"{answer.value} ({self.reply!r})" if refused else answer.value
        return f"{refusal}; {motion_in_words(sample)}"


def motion_in_words(sample: Sample | None) -> str:
    """What the newest sample says of the arm's motion, and how old it is."""
    if sample is None:
        return "whether the arm moves is not known"
    age = time.monotonic() - sample.content["host_time_ns"] / 1e9
    speed = float(np.abs(sample.content["joint_speeds"]).max())
    state = "stood still" if speed < STILL_RAD_S else f"moved at {np.degrees(speed):.0f} degrees/s"
    return f"the arm {state} {age:.1f} s ago"
