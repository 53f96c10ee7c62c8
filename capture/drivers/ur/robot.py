"""An arm of Universal Robots. The client of its controller lives in a child process because the vendor's can hang or crash.

The parent keeps every deadline, watches the stream of states, and has a connection of its own to stop the arm.
"""

import logging
import threading
import time
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import CaptureError, MotionError, NotSettled, RigConnectionError, StopLatched
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.measurements import RobotState
from koala3d.capture.drivers.safety import Limits
from koala3d.capture.drivers.ur.client import ClientChoice, StartFailure
from koala3d.capture.drivers.ur.faults import Aftermath, start_remedy
from koala3d.capture.drivers.ur.freedrive import HandGuided
from koala3d.capture.drivers.ur.link import ChildLink, Deadlines, Sample
from koala3d.capture.drivers.ur.pendant import Pendant, client_for, require_ready
from koala3d.capture.drivers.ur.settling import NOISIEST_RAD, Settling, Window, noise_of
from koala3d.capture.drivers.ur.stand_in import runtime_state
from koala3d.capture.drivers.ur.stop_channel import STILL_RAD_S, StopChannel, StopReply
from koala3d.capture.model.arm import identify
from koala3d.capture.model.kinematics import pose_from_six
from koala3d.datasets import pose

log = logging.getLogger(__name__)
MAY_MOVE_BITS = 0b11
"""Of the safety status: normal and reduced mode. Every other bit is a stop, a fault, or recovery."""
HEARD_S = 0.05  # how long a sample is waited for at once [s]
NOISE_S, NOISE_SAMPLES = 0.3, 60
"""How long, and for how many samples, the noise of the resting arm is measured on entering [s, host's clock]."""


class UniversalRobot(HandGuided):
    """One arm of Universal Robots: moves to joint angles, reports where the flange is.

    Poses are `base_from_flange` in metres in the base of the teach pendant. The controller reports the tool centre
    point; its active offset is read on entering, removed here and kept in `description`.

    Entering succeeds completely or leaves nothing open; leaving may happen twice. `move_to` returns with the arm within
    `tolerance` of the target and still. On every exception, Ctrl-C included, the arm is ordered to stop. After a fault
    the connection is closed: enter again. After `stop` nothing moves until `clear_stop`, entering again included. One owner;
    only `stop` may be called from another thread.

    Args:
        tolerance: largest difference between measured and target angles at the end of a motion [rad].
        frequency: requested sample rate of the controller [Hz].
        client: "ur_rtde", the vendor's; "koala", our own; or "auto": the vendor's where it is installed and there is a dashboard.
        registers: those that the vendor's client takes, "lower" (0 to 23) or "upper" (24 to 47).
        take_over: end a program that runs on the controller; else entering leaves it alone and raises NotReady.
    """

    def __init__(
        self,
        host: str,
        *,
        limits: Limits | None = None,
        settling: Settling | None = None,
        deadlines: Deadlines | None = None,
        tolerance: float = 1e-3,
        frequency: float = 500.0,
        client: str = ClientChoice.AUTO,
        registers: str = "lower",
        take_over: bool = False,
    ) -> None:
        self.host, self.limits, self.settling = host, limits or Limits(), settling or Settling()
        self.tolerance, self.frequency, self.deadlines = tolerance, frequency, deadlines or Deadlines()
        self.client, self.registers, self.take_over = ClientChoice(client), registers, take_over
        self.noise = 0.0  # of the resting arm's angles, measured on entering [rad]
        self._stop_channel = StopChannel(host)
        self._link: ChildLink | None = None
        self._tcp_from_flange = np.eye(4)
        self._description: dict[str, Any] = {}
        self._stopped = threading.Event()
        self._slider = 1.0

    def __enter__(self) -> Self:
        """Connect. Raises RigConnectionError or NotReady, with nothing left open."""
        self.close()
        try:
            pendant = self._stop_channel.connect()
            require_ready(pendant, self.host)
            if not runtime_state(self.host):  # clients would wait for samples, the vendor's holding its interpreter
                remedy = "enable RTDE at the pendant, restart the controller, then run again"
                raise RigConnectionError("RTDE sends no samples", where=self.host, remedy=remedy)
            self._stop_channel.take(1.0 / self.deadlines.watchdog_hz + 1.0, by_force=self.take_over)
            client, watchdog_hz = client_for(pendant, self.client, self.host), self.deadlines.watchdog_hz
            self._link = ChildLink.start(client, self.host, self.frequency, watchdog_hz, self.registers)
            ready = self._link.wait_for(("ready", "failed"), self.deadlines.connect_s)
            if ready is None or "failed" in ready:
                raise self._no_connection(self._link, ready)
            self._describe(pendant, ready["client"], ready["tcp_offset"])
            self._description["model"] = _model(self.state())
            self.noise = min(noise_of(self._link.watched(NOISE_S, NOISE_SAMPLES)), NOISIEST_RAD)
            self._description["noise_rad"] = self.noise
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if exception and exception[0] is not None and self._link is not None:  # without a link a fault has stopped it
                self.stop()
        finally:
            self.close()

    def close(self) -> None:
        """Let the arm come to rest and close everything; may be called twice."""
        link, self._link = self._link, None
        if link is not None:
            link.close()
        self._stop_channel.release()

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        """The newest state, and where asked for one that arrived after a time of the monotonic host clock [ns].

        Raises RigConnectionError where no new one arrives within a second.
        """
        patience_s = 1.0 + self.deadlines.stale_s
        sample = self._connected().fresh_sample(self.deadlines.stale_s, timeout_s=patience_s, newer_than_ns=newer_than_ns)
        if sample is None:
            raise self._fault("no state arrives from the robot", RigConnectionError)
        if not sample.content["connected"]:  # the client goes on returning the last values
            raise self._fault("the connection to the robot was lost", RigConnectionError)
        return RobotState(
            base_from_flange=pose_from_six(sample.content["tcp_pose"]) @ self._tcp_from_flange,
            joints=np.asarray(sample.content["joints"]),
            joint_speeds=np.asarray(sample.content["joint_speeds"]),
            robot_time_s=float(sample.content["robot_time_s"]),
            host_time_ns=int(sample.content["host_time_ns"]),
            joint_temperatures=tuple(sample.content["joint_temperatures"]),
        )

    def move_to(self, joints: NDArray[np.float64], *, speed: float, acceleration: float) -> None:
        """Move to (6,) joint angles [rad] at most at `speed` [rad/s] and `acceleration` [rad/s^2]; return when settled.

        Raises:
            SafetyError: the target or the speed is outside the limits; nothing has moved.
            StopLatched: the arm was stopped and not cleared; nothing has moved.
            ProtectiveStop: the controller has stopped the arm for safety.
            NotSettled: it arrived, and does not come to rest.
            MotionError: it did not arrive, or was stopped; it stands still.
            RigConnectionError: the connection was lost; the arm is ordered to stop, and stops by its watchdog in any case.
        """
        target = self.limits.check(joints, speed, acceleration)
        if self._stopped.is_set():
            why, remedy = "nothing moves after a stop until it is cleared", "make sure that nobody is in reach, then clear_stop()"
            raise StopLatched("the arm was stopped on request", where=self.host, why=why, remedy=remedy)
        start = self.state().joints
        event("move", joints_deg=np.degrees(target).round(4).tolist(), speed=speed, acceleration=acceleration)
        try:
            self._move(target, start, speed, acceleration)
            self._settle(target)
        except CaptureError:
            raise  # the arm was stopped where the error was found
        except BaseException:
            self.stop()
            raise

    @property
    def states_received(self) -> int:
        """Number of states received since entering, each with a different time stamp of the controller."""
        return self._connected().samples

    def stop(self) -> None:
        """Bring the arm to rest, by the client if it answers, else by the controller; it stays there until `clear_stop`.

        Any thread, any number of times. Raises RigConnectionError where nothing confirms that the arm stops.
        """
        self._stopped.set()
        event("stop", host=self.host)
        link = self._link
        if link is not None and link.request("stop", deceleration=3.0) and self._rests_within(2.0):
            return
        answer = self._stop_channel.stop()
        if answer is not StopReply.STOPPED and not self._rests_within(0.3):
            raise RigConnectionError(
                "nothing confirms that the arm stops",
                where=self.host,
                why=self._stop_channel.known(answer, None if link is None else link.newest),
                remedy="press the emergency stop",
            )

    def clear_stop(self) -> None:
        """Allow motions again after `stop`."""
        self._stopped.clear()

    def description(self) -> dict[str, Any]:
        """Model, address, serial number, software, tool offset and noise of the arm, and the client in use."""
        return dict(self._description)

    def _connected(self) -> ChildLink:
        if self._link is None:
            raise RigConnectionError("the robot is not connected", where=self.host, remedy="enter the context again")
        return self._link

    def _describe(self, pendant: Pendant, client: str, tcp_offset: list[float]) -> None:
        if len(tcp_offset) != 6:
            raise RigConnectionError("the tool offset cannot be read", where=self.host, remedy="run again")
        self._tcp_from_flange = pose.inverse(pose_from_six(tcp_offset))
        self._description = {
            "host": self.host,
            "serial": pendant.serial(),
            "software": pendant.version(),
            "client": client,
            "tcp_offset": [float(number) for number in tcp_offset],
        }

    def _move(self, target: NDArray[np.float64], start: NDArray[np.float64], speed: float, acceleration: float) -> None:
        link = self._connected()
        number = link.request("move", joints=target.tolist(), speed=speed, acceleration=acceleration)
        answer = link.wait_for(("accepted", "refused"), self.deadlines.accept_s, number=number) if number else None
        if answer is None or "refused" in answer:
            raise self._refused(link)
        distance = float(np.abs(target - start).max())
        left_s = 1.5 * (distance / speed + speed / acceleration) + 3.0  # at full speed
        sample, before = None, time.monotonic()
        for newer in self._samples(link):
            sample, now = newer or sample, time.monotonic()
            left_s, before = left_s - (now - before) * self._speed_fraction(sample), now
            if sample is not None and sample.content["operation"] != answer["operation_before"] and not sample.content["moving"]:
                return
            if left_s < 0:
                left = np.degrees(np.abs(target - np.asarray(sample.content["joints"])).max()) if sample else np.nan
                raise self._fault(f"the motion took too long, {left:.1f} degrees are left")

    def _refused(self, link: ChildLink) -> CaptureError:
        """Why the controller did not accept a motion: waits a moment for a state that gives the reason."""
        deadline, sample = time.monotonic() + 0.3, None
        while time.monotonic() < deadline:
            sample = link.next_sample(sample, timeout_s=0.05) or sample
            if not link.alive or (sample is not None and (_unsafe(sample) or not sample.content["connected"])):
                break
        if sample is not None and not _unsafe(sample) and sample.content["connected"] and not sample.content["running"]:
            return self._fault(
                "the controller ended its program instead of moving",
                remedy="its log at the pendant says why (a pose that it cannot reach, a limit); then resume",
            )
        try:
            self._watch(link, sample, 0.0)
        except CaptureError as error:
            return error
        return self._fault("the controller did not accept the motion")

    def _speed_fraction(self, sample: Sample | None) -> float:
        """Position of the speed slider, 0.01 to 1: motions are slower and their deadlines longer by this factor."""
        fraction = 1.0 if sample is None else min(max(float(sample.content["speed_fraction"]), 0.01), 1.0)
        if fraction < 1.0 and fraction != self._slider:
            log.warning("the speed slider stands at %.0f %%: motions take %.1f times as long", 100 * fraction, 1 / fraction)
        self._slider = fraction
        return fraction

    def _settle(self, target: NDArray[np.float64]) -> None:
        """Return once the arm is still and at the target. Raises NotSettled: it is at the target and not still in time."""
        begun, settling, window = time.monotonic(), self.settling, Window(self.settling.time_s)
        for sample in self._samples(self._connected()):
            if sample is not None:
                window.add(sample.content["robot_time_s"], sample.content["joints"])
                if window.rests(settling.spread, self.noise):
                    missed = float(np.abs(window.mean - target).max())
                    if missed > self.tolerance:
                        raise self._fault(f"the arm stopped {np.degrees(missed):.3f} degrees from its target")
                    return
            if time.monotonic() - begun > settling.timeout_s + settling.time_s:
                why = f"its joints vary by {window.deviation:.1e} rad (standard deviation), at rest by {self.noise:.1e}"
                remedy = f"look for what moves it, or raise motion.settle_spread, {settling.spread:.1e} rad; then resume"
                raise NotSettled("the arm does not come to rest", where=self.host, why=why, remedy=remedy)

    def _samples(self, link: ChildLink) -> Iterator[Sample | None]:
        """Every new sample, None where none came for a moment; raises where a motion cannot continue."""
        sample, silence_s = None, 0.0
        while True:
            begun = time.monotonic()
            newer = link.next_sample(sample, timeout_s=HEARD_S)
            # if this process was not served for longer, so was the thread that reads: samples may lie in the socket
            silence_s = 0.0 if newer is not None else silence_s + min(time.monotonic() - begun, 2 * HEARD_S)
            sample = newer or sample
            self._watch(link, sample, silence_s)
            yield newer

    def _watch(self, link: ChildLink, sample: Sample | None, silence_s: float) -> None:
        """Raise where a motion cannot continue."""
        if self._stopped.is_set():
            raise self._stopped_error()
        if not link.alive:
            raise self._fault("the connection to the robot broke down", RigConnectionError)
        if silence_s > self.deadlines.stale_s + (0.0 if sample is not None else 0.3):  # the first may still be on its way
            raise self._fault("the robot's data stream stands still", RigConnectionError)
        if sample is not None and _unsafe(sample):
            raise self._fault("the robot was stopped for safety")
        if sample is not None and not sample.content["connected"]:
            raise self._fault("the connection to the robot was lost", RigConnectionError)
        if sample is not None and not sample.content["running"]:
            raise self._fault("the robot's program was stopped or paused")

    def _stopped_error(self) -> CaptureError:
        why = "the arm stands still"
        if not self._rests_within(3.0):
            why = self._stop_channel.known(self._stop_channel.stop(), None if self._link is None else self._link.newest)
        return MotionError("the motion was stopped on request", where=self.host, why=why)

    def _fault(self, what: str, kind: type[CaptureError] = MotionError, *, remedy: str = "resume the recording") -> CaptureError:
        """Stop the arm by every means, close, and find out what happened; an error of `kind` unless the controller knows more."""
        answer = self._stop_channel.stop()
        link, self._link = self._link, None
        printed = link.kill() if link is not None else ""
        safety, mode = self._stop_channel.safety_and_mode()
        known = self._stop_channel.known(answer, None if link is None else link.newest)
        self.close()
        known = "; ".join(filter(None, (known, printed)))
        return Aftermath(self.host, answer, known, safety, mode).error(what, kind, remedy)

    def _rests_within(self, seconds: float) -> bool:
        link, deadline = self._link, time.monotonic() + seconds
        while link is not None and time.monotonic() < deadline:
            sample = link.fresh_sample(self.deadlines.stale_s, timeout_s=0.1)
            if sample is not None and np.abs(sample.content["joint_speeds"]).max() < STILL_RAD_S:
                return True
            time.sleep(0.01)
        return False

    def _no_connection(self, link: ChildLink, answer: dict[str, Any] | None) -> CaptureError:
        if answer:
            why = answer["failed"]
        else:
            silence = f"no answer within {self.deadlines.connect_s:.0f} s" if link.alive else "its client ended"
            why = f"{silence}. {link.kill()}".strip()
        failure = StartFailure(answer["failure"]) if answer else StartFailure.OTHER
        remedy = start_remedy(failure, self.client, self.registers)
        return RigConnectionError("the robot does not take the control program", where=self.host, why=why, remedy=remedy)


def _model(state: RobotState) -> str:
    """Which arm it is, by where it says its flange is at its joint angles; "unknown" where it is none that we know."""
    found = identify(state.joints, state.base_from_flange)
    return found.model.name if found.certain else "unknown"


def _unsafe(sample: Sample) -> bool:
    """Whether the controller has stopped the arm for safety."""
    return bool(sample.content["safety_bits"] & ~MAY_MOVE_BITS)
