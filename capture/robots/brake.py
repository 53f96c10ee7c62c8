"""Stops the arm over the dashboard, which answers when every other connection hangs, and says what is known of the arm then."""

import threading
import time
from enum import Enum

import numpy as np

from capture.errors import NotReady, RigConnectionError
from capture.robots.dashboard import Dashboard
from capture.robots.link import Sample

BUSY = ("PLAYING", "PAUSED")  # states of a program that somebody may want to go on
STILL_RAD_S = 0.01
"""Below this speed of its fastest joint an arm counts as at rest [rad/s]: ten times the noise of measured speeds."""


class Answer(Enum):
    """What became of an order to stop."""

    STOPPED = "the arm was stopped"
    IDLE = "the controller runs no program"
    REFUSED = "the controller refuses to stop its program"
    SILENT = "the dashboard does not answer either"


class Brake:
    """The dashboard connection of a driver. Any thread may stop the arm through it."""

    def __init__(self, host: str) -> None:
        self.host = host
        self.dashboard: Dashboard | None = None
        self.reply = ""  # of the dashboard, where it refused
        self._ours = False  # whether a program that runs may be ended on leaving
        self._lock = threading.Lock()

    def connect(self) -> Dashboard:
        """Open the connection. Raises RigConnectionError: no UR controller answers there."""
        self.dashboard = Dashboard.connect(self.host)
        return self.dashboard

    def take(self, patience_s: float, *, by_force: bool) -> None:
        """End what a killed client has left; it would block the next client for minutes.

        Raises NotReady: a program still runs or is paused after `patience_s`, in which the watchdog ends a killed client's. It
        is left alone, also on `release`, unless `by_force`.
        """
        dashboard, deadline = self.dashboard or self.connect(), time.monotonic() + patience_s
        while not by_force and (state := dashboard.ask("programState")).startswith(BUSY):
            if time.monotonic() > deadline:
                remedy = "wait for it, stop it at the pendant, or take over: 'capture run --take-over' ends it"
                raise NotReady("a program runs on the robot and was left alone", where=self.host, why=state, remedy=remedy)
            time.sleep(0.05)
        self._ours = True
        dashboard.ask("stop")

    def stop(self) -> Answer:
        """Order the controller to end its program; tries again over a new connection. Only the reply "Stopped" is a stop."""
        with self._lock:
            for attempt in range(2):
                try:
                    dashboard = self.connect() if attempt or self.dashboard is None else self.dashboard
                    self.reply = dashboard.ask("stop")
                    if self.reply == "Stopped":
                        return Answer.STOPPED
                    return Answer.REFUSED if dashboard.program_running() else Answer.IDLE
                except RigConnectionError:
                    continue
        return Answer.SILENT

    def safety_and_mode(self) -> tuple[str, str]:
        """What the dashboard says of them; empty where it does not answer."""
        try:
            return (self.dashboard.safety_status(), self.dashboard.robot_mode()) if self.dashboard else ("", "")
        except RigConnectionError:
            return "", ""

    def release(self) -> None:
        """End the program, if it is ours, and close the connection; may be called twice."""
        (dashboard, self.dashboard), (ours, self._ours) = (self.dashboard, None), (self._ours, False)
        if dashboard is not None:
            try:
                if ours:
                    dashboard.ask("stop")
            except RigConnectionError:
                return  # unreachable: the watchdog ends the program
            finally:
                dashboard.close()

    def known(self, answer: Answer, sample: Sample | None) -> str:
        """What is known of the arm after an order to stop, in words; `sample` is the newest one."""
        if answer is Answer.STOPPED:
            return answer.value
        refusal = f"{answer.value} ({self.reply!r})" if answer is Answer.REFUSED else answer.value
        return f"{refusal}; {motion_in_words(sample)}"


def motion_in_words(sample: Sample | None) -> str:
    """What the newest sample says of the arm's motion, and how old it is."""
    if sample is None:
        return "whether the arm moves is not known"
    age = time.monotonic() - sample.content["host_time_ns"] / 1e9
    speed = float(np.abs(sample.content["joint_speeds"]).max())
    state = "stood still" if speed < STILL_RAD_S else f"moved at {np.degrees(speed):.0f} degrees/s"
    return f"the arm {state} {age:.1f} s ago"
