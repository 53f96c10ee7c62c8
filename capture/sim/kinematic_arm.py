"""A simulated arm of any model, for arms whose controller Koala does not speak to.

It moves as the simulated controller's arm does, with the same errors and oscillations, but in this process and without protocol.
"""

import threading
import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import MotionError, NotSettled, RigConnectionError, StopLatched
from koala3d.capture.drivers.events import event
from koala3d.capture.drivers.measurements import RobotState
from koala3d.capture.drivers.safety import Limits
from koala3d.capture.drivers.ur.settling import Settling, Window
from koala3d.capture.model.arm import ArmModel
from koala3d.capture.sim.controller.motions.arm import SimulatedArm

Array = NDArray[np.float64]
TICK_S = 0.002  # period of the simulation in its own time [s]
DECELERATION = 3.0  # of the fastest joint after `stop` [rad/s^2]


class KinematicArm:
    """Implements `capture.drivers.protocols.Robot`, and what a simulated camera needs.

    Args:
        model: which arm it is.
        limits: targets are judged by these; None: the model's own.
        settling: when the arm counts as still.
        seed: of the errors of each stop.
        time_scale: speed of the arm's clock relative to real time.
        links_seed: of the links as built; None: `seed`.
        length_m, angle_rad: standard deviations of these links from the nominal ones.
        repeatability_m, repeatability_rad: standard deviations per axis of where the flange stops.
        hangs: start where an arm that hangs is out of the way.
    """

    def __init__(
        self,
        model: ArmModel,
        *,
        limits: Limits | None = None,
        settling: Settling | None = None,
        seed: int = 0,
        time_scale: float = 20.0,
        links_seed: int | None = None,
        length_m: float = 5e-4,
        angle_rad: float = float(np.radians(0.05)),
        repeatability_m: float = 3e-5,
        repeatability_rad: float = float(np.radians(0.005)),
        hangs: bool = False,
    ) -> None:
        self.model, self.time_scale = model, time_scale
        self.limits = Limits.of(model, np.inf, np.inf) if limits is None else limits
        self.settling = settling or Settling()
        rng = np.random.default_rng([seed if links_seed is None else links_seed, 1])
        links = model.links.calibrated(rng, length_m, angle_rad)
        home = model.hanging_home if hangs else model.home
        self._arm = SimulatedArm(seed, home, repeatability_m, repeatability_rad, links, model=model)
        self._began = time.monotonic()
        self._stopped, self._lock, self._entered = threading.Event(), threading.Lock(), False

    def __enter__(self) -> Self:
        self._entered = True
        return self

    def __exit__(self, *exception: object) -> None:
        if exception and exception[0] is not None:
            self.stop()
        self._entered = False

    @property
    def now(self) -> float:
        """The arm's own clock [s]."""
        return (time.monotonic() - self._began) * self.time_scale

    def state(self, *, newer_than_ns: int = 0) -> RobotState:
        """See `Robot`. A state is always of this moment."""
        self._require_entered()
        with self._lock:
            now = self.now
            joints, speeds = self._arm.measured(now)
            return RobotState(self._arm.base_from_tcp(joints), joints, speeds, now, time.monotonic_ns())

    def move_to(self, joints: Array, *, speed: float, acceleration: float) -> None:
        """See `Robot`. Raises SafetyError, StopLatched, or MotionError where it was stopped or does not come to rest."""
        self._require_entered()
        target = self.limits.check(joints, speed, acceleration)
        if self._stopped.is_set():
            why, remedy = "nothing moves after a stop until it is cleared", "clear_stop()"
            raise StopLatched("the arm was stopped on request", where=self.model.name, why=why, remedy=remedy)
        event("move", joints_deg=np.degrees(target).round(4).tolist(), speed=speed, acceleration=acceleration)
        with self._lock:
            self._arm.move_to(target, speed, acceleration, self.now)
        try:
            while self._moving():
                self._wait()
            self._settle()
        except NotSettled:
            raise
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """See `Robot`."""
        self._stopped.set()
        event("stop", host=self.model.name)
        with self._lock:
            self._arm.stop(DECELERATION, self.now)

    def freedrive(self, on: bool) -> None:
        """See `capture.drivers.ur.freedrive`."""
        self._require_entered()
        with self._lock:
            self._arm.freedrive = on
        event("freedrive", on=on)

    def clear_stop(self) -> None:
        """See `Robot`."""
        self._stopped.clear()

    def description(self) -> dict[str, Any]:
        """See `Robot`."""
        return {"model": self.model.name, "client": "kinematic simulation", "simulated": True, "tcp_offset": [0.0] * 6}

    def true_base_from_flange(self) -> Array:
        """(4, 4) where the flange really is now [m]."""
        return self.exposed(0.0, 1)[0]

    def exposed(self, exposure_s: float, count: int) -> Array:
        """(count, 4, 4) where the flange really is during an exposure that begins now [m]."""
        with self._lock:
            moments = self.now + (np.arange(count) + 0.5) / max(count, 1) * exposure_s
            return np.stack([self._arm.true_base_from_flange(moment) for moment in moments])

    def signals(self) -> dict[str, Any]:
        """Electrical outputs: it has no controller, and nothing is on."""
        return {"digital": 0}

    def _require_entered(self) -> None:
        if not self._entered:
            raise RigConnectionError("the robot is not connected", where=self.model.name, remedy="enter the context again")

    def _moving(self) -> bool:
        with self._lock:
            return self._arm.moving(self.now)

    def _wait(self) -> None:
        """Let a moment pass; raises MotionError where the arm was stopped."""
        if self._stopped.is_set():
            raise MotionError("the motion was stopped on request", where=self.model.name, why="the arm stands still")
        time.sleep(max(TICK_S / self.time_scale, 1e-4))

    def _settle(self) -> None:
        begun, window = time.monotonic(), Window(self.settling.time_s)
        while True:
            state = self.state()
            window.add(state.robot_time_s, state.joints)
            if window.rests(self.settling.spread, self._arm.noise_rad):
                return
            if time.monotonic() - begun > self.settling.timeout_s + self.settling.time_s:
                why, remedy = f"its joints vary by {window.deviation:.1e} rad", "raise motion.settle_spread"
                raise NotSettled("the arm does not come to rest", where=self.model.name, why=why, remedy=remedy)
            self._wait()
