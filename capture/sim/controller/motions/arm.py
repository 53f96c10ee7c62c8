"""The simulated arm: what its encoders say, where its flange really is, and whether it may move.

Time is the controller's own [s] and is passed in. Nothing here uses sockets.
"""

import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.ur.modes import RobotMode, SafetyMode, may_move
from koala3d.capture.model.arm import DEFAULT, ArmModel, load_arm
from koala3d.capture.model.kinematics import Links, forward
from koala3d.capture.sim.controller.motions.profiles import Braking, Chain, Joints, Move, Profile, Slowing, end_of
from koala3d.capture.sim.controller.motions.tempo import Tempo
from koala3d.capture.sim.controller.motions.tracking import Tool, Tracked
from koala3d.capture.sim.controller.motions.warmth import Warmth
from koala3d.datasets import pose

SAFETY_DECELERATION = 10.0  # of the fastest joint when the arm is stopped for safety [rad/s^2]
PAUSE_S = 0.3  # a paused motion slows down on its path within this time, and speeds up within it when it is resumed [s]
RINGING_HZ, RINGING_DECAY_S, RINGING_PER_ACCELERATION = 12.0, 0.06, 1.5e-4
"""After a stop the joints oscillate, which the encoders measure: frequency, decay time, and amplitude [rad per rad/s^2]."""
FLEXURE_HZ, FLEXURE_DECAY_S, FLEXURE_PER_ACCELERATION = 9.0, 0.07, 1.5e-3
"""Tubes, gears and bracket bend as well, which no encoder measures: as above."""
SPEED_NOISE_PER_S = 250.0
"""Noise of measured speeds per noise of measured angles [1/s]: they are differences of angles 4 ms apart."""
QUIET_S = 0.36  # this long after a stop both have decayed to less than a hundredth, and count as zero [s]

STOPS = Braking, Slowing
"""Motions that are stops: the speed slider and a pause do not change them."""
PUSHED_SPEED, PUSHED_ACCELERATION = 1.0, 2.0  # of the fastest joint, as a person moves the arm by hand [rad/s, rad/s^2]


@dataclass(frozen=True)
class Payload:
    """What a program says that the flange carries. `centre`: None is that of the installation."""

    mass: float  # [kg]
    centre: tuple[float, ...] | None  # of gravity in the flange [m]
    inertia: tuple[float, ...]  # about the centre: xx, yy, zz, xy, xz, yz [kg m^2]


class SimulatedArm:
    """One arm with errors of its own.

    Args:
        seed: of everything random.
        home: (n,) angles at the start [rad].
        repeatability_m: standard deviation per axis of where the flange really stops [m].
        repeatability_rad: the same of its orientation [rad].
        links: the true links, which the controller is calibrated to; they differ from the nominal ones. None: they do not.
        noise_rad: standard deviation of the angles that the encoders measure [rad].
        model: its nominal links and its limits; None: a UR5e.
    """

    def __init__(
        self,
        seed: int,
        home: Joints,
        repeatability_m: float,
        repeatability_rad: float,
        links: Links | None = None,
        noise_rad: float = 0.0,
        model: ArmModel | None = None,
    ) -> None:
        self.model = load_arm(DEFAULT) if model is None else model
        self.seed, self.links, self.noise_rad = seed, self.model.links if links is None else links, noise_rad
        self._noise = np.random.default_rng([seed, 11])
        self.warmth = Warmth()
        self.deviation = repeatability_m, repeatability_rad
        self.flange_from_tcp = np.eye(4)
        self.mode, self.safety = RobotMode.RUNNING, SafetyMode.NORMAL
        self.profile: Profile = Braking(np.asarray(home, np.float64), np.zeros(len(home)), 1.0)
        self.speed_fraction = 1.0
        self.joint_limits = np.stack([self.model.lower, self.model.upper])
        self.reach_m = np.inf
        self.freedrive, self.button = False, False
        """Whether a person can move the arm by hand, and whether the pendant's button for that is pressed."""
        self.payload: Payload | None = None
        self.why = ""
        """Why it has stopped for safety by itself, until that is reported."""
        self._tempo = Tempo(0.0, 0.0, 1.0, 1.0)
        self.motions: deque[tuple[float, Profile]] = deque(maxlen=1000)
        self._visits: dict[int, int] = {}
        self._error: NDArray[np.float64] | None = None

    @property
    def may_move(self) -> bool:
        """Powered, brakes released and not stopped for safety."""
        return self.mode is RobotMode.RUNNING and may_move(self.safety.name)

    def phase(self, now: float) -> float:
        """Time within the motion [s]: slower than the clock where the speed slider is below 100 %."""
        return self._tempo.phase(now)

    def moving(self, now: float) -> bool:
        """Whether a motion is under way and not paused."""
        return self._unfinished(now) and not self._tempo.stopped(now)

    def _unfinished(self, now: float) -> bool:
        return bool(self.phase(now) < self.profile.duration)

    def target(self, now: float) -> tuple[Joints, Joints, Joints]:
        """(n,) commanded angles, speeds and accelerations."""
        angles, speeds, accelerations = self.profile.at(self.phase(now))
        rate = self._tempo.rate(now)
        return angles, speeds * rate, accelerations * rate**2

    def measured(self, now: float) -> tuple[Joints, Joints]:
        """(n,) angles and speeds that the encoders measure: `actual` and their noise, another one at every call."""
        angles, speeds = self.actual(now)
        if self.noise_rad == 0:
            return angles, speeds
        noise = self.noise_rad * self._noise.normal(size=(2, len(angles)))
        return angles + noise[0], speeds + SPEED_NOISE_PER_S * noise[1]

    def actual(self, now: float) -> tuple[Joints, Joints]:
        """(n,) angles and speeds of the joints: the target plus the oscillation after a stop."""
        angles, speeds, _ = self.target(now)
        swing, swing_speed = self._swing(now, RINGING_HZ, RINGING_DECAY_S, RINGING_PER_ACCELERATION)
        return angles - swing, speeds - swing_speed

    def _swing(self, now: float, frequency_hz: float, decay_s: float, amplitude: float) -> tuple[Joints | float, Joints | float]:
        """(n,) damped oscillation after the end of a motion [rad], and its speed [rad/s]; 0 in motion and long after it."""
        if self._unfinished(now) or self.profile.duration == 0:
            return 0.0, 0.0
        rate = self._tempo.rate(now)
        since = (self.phase(now) - self.profile.duration) / rate
        if since >= QUIET_S:
            return 0.0, 0.0
        slowing = self.profile.at(self.profile.duration * (1 - 1e-6))[2] * rate**2
        omega = 2 * np.pi * frequency_hz
        size = amplitude * slowing * np.exp(-since / decay_s)
        sine, cosine = np.sin(omega * since), np.cos(omega * since)
        return size * sine, size * (omega * cosine - sine / decay_s)

    def swings_for(self, profile: Profile, spread: float) -> float:
        """Seconds after the end of a motion at full speed from which on no joint varies by more than `spread` [rad]."""
        if np.isinf(profile.duration):
            return 0.0
        slowing = np.abs(profile.at(profile.duration * (1 - 1e-6))[2]).max()
        since = np.arange(0.0, QUIET_S, 1e-4)
        size = RINGING_PER_ACCELERATION * slowing * np.exp(-since / RINGING_DECAY_S)
        swing = size * np.sin(2 * np.pi * RINGING_HZ * since)
        ahead = np.maximum.accumulate(swing[::-1])[::-1] - np.minimum.accumulate(swing[::-1])[::-1]
        wide = np.flatnonzero(ahead > spread)
        return float(since[wide[-1]]) if len(wide) else 0.0

    def base_from_tcp(self, joints: Joints) -> NDArray[np.float64]:
        """(4, 4) as the controller reports it: calibrated links, active tool offset [m]."""
        return forward(joints, self.links) @ self.flange_from_tcp

    def true_base_from_flange(self, now: float) -> NDArray[np.float64]:
        """(4, 4) where the flange really is [m]: bent after a stop, off by the error of this visit, and moved by warmth.

        The error changes with every stop, and is the same for the same place and number of visits.
        """
        bent = self._swing(now, FLEXURE_HZ, FLEXURE_DECAY_S, FLEXURE_PER_ACCELERATION)[0]
        stands = forward(self.actual(now)[0] - bent, self.links) @ self._stopping_error()
        stands[:3, 3] += self.warmth.shift(now)
        return stands

    @property
    def tool(self) -> Tool:
        """The tool as it is mounted now."""
        return Tool(self.links, self.flange_from_tcp, self.model.speed)

    def heading(self, now: float) -> tuple[Joints, Joints]:
        """(n,) commanded angles, and the speeds from which a motion that begins now goes on without a jerk."""
        angles, speeds, _ = self.target(now)
        return angles, speeds / self.speed_fraction

    def waypoint(self, now: float) -> Joints:
        """(n,) angles at which the motion will end; where the arm is if it stands still or goes on until it is stopped."""
        return end_of(self.profile) if np.isfinite(self.profile.duration) else self.target(now)[0]

    def begin(self, profile: Profile, now: float, *, goes_on: bool = False) -> None:
        """Start a motion from where the arm is. `goes_on`: it changes the latest one, and is not listed as another one."""
        self.profile, self._error = profile, None
        self._tempo = Tempo(0.0, now, self._full_rate, self._full_rate)
        if goes_on and self.motions:
            self.motions[-1] = self.motions[-1][0], profile
        else:
            self.motions.append((now, profile))

    def begin_from_rest(self, make: Callable[[Joints], Profile], deceleration: float, now: float) -> float:
        """Start the motion that `make` gives from the (n,) angles at which the arm comes to rest; returns when that is [s]."""
        angles, speeds, _ = self.target(now)
        stop = Braking(angles, speeds, deceleration)
        motion = make(end_of(stop))
        moving = self.moving(now)
        self.begin(Chain(stop, motion) if moving else motion, now)
        return stop.duration if moving else 0.0

    @property
    def _full_rate(self) -> float:
        return 1.0 if isinstance(self.profile, STOPS) else self.speed_fraction

    def set_speed_slider(self, fraction: float, now: float) -> None:
        """Set the speed slider to a fraction 0..1 of the commanded speed; it applies to a motion under way."""
        self.speed_fraction = min(max(fraction, 0.01), 1.0)
        if self._tempo.last > 0:
            self._tempo = Tempo(self.phase(now), now, self._full_rate, self._full_rate)

    def pause(self, now: float) -> None:
        """Slow down to rest on the path of a motion, which `resume` continues; does nothing to an arm that is stopping."""
        if self.moving(now) and not isinstance(self.profile, STOPS):
            self._tempo = Tempo(self.phase(now), now, self._tempo.rate(now), 0.0, PAUSE_S)

    def resume(self, now: float) -> None:
        """Continue a motion that was paused."""
        if self._unfinished(now):
            self._tempo = Tempo(self.phase(now), now, self._tempo.rate(now), self._full_rate, PAUSE_S)

    def check_limits(self, now: float) -> None:
        """Stop for safety where a joint has left its range, and where the path of the tool cannot be followed."""
        angles = self.target(now)[0]
        if not self.may_move:
            return
        beyond = np.maximum(self.joint_limits[0] - angles, angles - self.joint_limits[1])
        if (beyond > 0).any():
            joint = int(beyond.argmax())
            self._protect(f"joint {joint + 1} has left its range at {np.degrees(angles[joint]):.0f} degrees", now)
        elif isinstance(self.profile, Tracked) and self.phase(now) >= self.profile.fault:
            self._protect("the tool's path leads out of reach, through a singularity, or faster than the joints turn", now)

    def reaches(self, joints: Joints) -> bool:
        """Whether the flange may go there."""
        return bool(np.linalg.norm(forward(joints, self.links)[:3, 3]) <= self.reach_m)

    def move_to(self, goal: Joints, speed: float, acceleration: float, now: float) -> None:
        """Start a movej; a moving arm slows down to rest first."""
        if not np.isfinite(goal).all() or not self.model.inside(goal):
            self._protect(f"a motion was ordered with {self.model.outside(goal) or 'numbers that are not finite'}", now)
            return
        top, acceleration = min(max(speed, 1e-3), float(self.model.speed.min())), max(acceleration, 1e-3)
        self.begin_from_rest(lambda start: Move(start, goal, top, acceleration), acceleration, now)

    def push(self, goal: Joints, now: float) -> None:
        """Move the joints by hand; nothing happens unless the arm is in freedrive, and no joint passes its limit."""
        if self.freedrive or self.button:
            self.move_to(np.clip(goal, *self.joint_limits), PUSHED_SPEED, PUSHED_ACCELERATION, now)

    def stop(self, deceleration: float, now: float) -> None:
        """Slow down to rest and forget the motion; does nothing to an arm at rest."""
        if self._unfinished(now):
            angles, speeds, _ = self.target(now)
            self.begin(Braking(angles, speeds, max(deceleration, 0.1)), now)

    def stop_tool(self, deceleration: float, now: float) -> None:
        """Slow down to rest on the path, the tool at a deceleration [m/s^2]; does nothing to an arm at rest."""
        if self._unfinished(now) and not isinstance(self.profile, STOPS):
            angles, speeds, _ = self.target(now)
            tool_speed = float(np.linalg.norm(self.tool.velocity(angles, speeds)[:3]))
            seconds = max(tool_speed / max(deceleration, 0.1), float(np.abs(speeds).max()) / SAFETY_DECELERATION)
            self.begin(Slowing(self.profile, self.phase(now), self._tempo.rate(now), seconds), now)

    def stop_for_safety(self, safety: SafetyMode, now: float) -> None:
        """Protective or emergency stop: slow down as fast as possible; an emergency stop also cuts the power."""
        self.stop(SAFETY_DECELERATION, now)
        self.safety = safety
        if safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.mode = RobotMode.POWER_OFF

    def _protect(self, why: str, now: float) -> None:
        self.why = f"protective stop: {why}"
        self.stop_for_safety(SafetyMode.PROTECTIVE_STOP, now)

    def _stopping_error(self) -> NDArray[np.float64]:
        if self._error is None:
            place = zlib.crc32(np.round(end_of(self.profile), 6).tobytes())
            visit = self._visits[place] = self._visits.get(place, 0) + 1
            draw = np.random.default_rng([self.seed, place, visit]).normal(size=6)
            self._error = pose.from_rotation_vector(draw[:3] * self.deviation[1], draw[3:] * self.deviation[0])
        return self._error
