"""How late the time stamps of pictures are, beside those of the arm's poses: estimated from pictures of a moving arm.

A picture with stamp t[i] was exposed at t[i] - latency, so the flange was at

    base_from_flange[i] = track(t[i] - latency),

and all else is as in `calib.handeye.model`. Its derivative by the latency is minus the flange's velocity, in flange axes, times
what a small correction of the flange does to the corners. The latency is refined together with the whole rig, with all pictures
of halts and of motion, so that its standard deviation holds what the rig leaves open.

The start needs no rig: between two pictures the camera turns by the same angle as the flange, whatever their relative pose.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from koala3d.calib.arrays import Array, Indices, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import model, outliers, refine
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.intrinsics import estimate
from koala3d.calib.sessions.session import Clocked, TargetSession
from koala3d.calib.solver.elimination import covariance_of
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.track import Track

LARGEST_S, STEP_S = 0.5, 0.005
"""Latencies that are looked for, to both sides, and the step of the search: the refinement bridges it."""
NEIGHBOURS = 4
"""Each picture is compared with so many later ones."""
LARGEST_TURN = float(np.deg2rad(2))
"""Larger disagreements of two angles count as this one: one wrong pose of the target must not decide."""
CLEARLY = 0.8
"""A start other than zero must lower the disagreement to this share."""
FEWEST = 5
"""Pictures of motion from which the latency is estimated."""
LARGEST_STD_S = 0.02
"""A latency that is less certain than about a picture's interval is not known [s]."""


@dataclass(frozen=True)
class Late:
    """A rig with a latency: the unknowns."""

    rig: State
    latency_s: float

    @property
    def corrections(self) -> Array:
        """(views, 6) of the arm's report."""
        return self.rig.corrections


@dataclass(frozen=True)
class LateMeasurements:
    """What was measured, with stamps that are late; a `refine.Problem`. The latency is the last global unknown."""

    measured: Measurements
    track: Track
    seconds: Array  # (views,) stamps since the first pose of the track [s]

    @property
    def view(self) -> Indices:
        """(n,) view of each corner."""
        return self.measured.view

    @property
    def pixels(self) -> Array:
        """(n, 2) corners as seen [px]."""
        return self.measured.pixels

    @property
    def accuracy(self) -> Accuracy:
        """Of the arm, as stated."""
        return self.measured.accuracy

    def some(self, chosen: Mask) -> "LateMeasurements":
        """The same with the corners of `chosen` (n,) alone."""
        return replace(self, measured=self.measured.some(chosen))

    def predicted(self, state: Late) -> tuple[Array, Array, Array]:
        """As `model.predict`, of the poses at the exposure."""
        moments = self.seconds - state.latency_s
        placed = replace(self.measured, base_from_flange=self.track.at(moments))
        pixels, by_global, by_view = model.predict(placed, state.rig)
        by_latency = -by_view @ self.track.speed(moments)[self.view][..., None]
        return pixels, np.concatenate([by_global, by_latency], -1), by_view

    def moved(self, state: Late, step: Array, view_steps: Array) -> Late:
        """`state` after a step."""
        return Late(self.measured.moved(state.rig, step[:-1], view_steps), state.latency_s + float(step[-1]))

    def known_rows(self, state: Late) -> Array:
        """What is known of the rig; nothing is of the latency."""
        return np.insert(self.measured.known_rows(state.rig), -1, 0.0, axis=1)


@dataclass(frozen=True)
class Latency:
    """How late stamps are."""

    seconds: float
    std: float  # standard deviation [s]
    pictures: int  # of a moving arm
    by_rig: Array  # (p,) change of the rig's unknowns per second of latency, if its views are of a moving arm
    speed_px: float  # how fast the picture of the target moves, in the middle of the pictures of motion [px/s]

    def facts(self) -> dict[str, Any]:
        """For the calibration file."""
        of_speed = {"latency_px_per_ms": 1e-3 * self.speed_px}
        return {"latency_s": self.seconds, "latency_std_s": self.std, "latency_pictures": self.pictures, **of_speed}

    def spread(self) -> Array:
        """(p, p) what its uncertainty adds to the covariance of the rig."""
        return self.std**2 * np.outer(self.by_rig, self.by_rig)


def guess(session: TargetSession, camera: Camera) -> float:
    """The latency [s] at which flange and camera turn by the same angles between pictures; 0 if none is clearly better."""
    clocked = session.clocked
    assert clocked is not None
    observations, seconds = _all(session.observations, clocked)
    if len(seconds) < FEWEST:
        return 0.0
    boards = estimate.camera_from_boards(camera, observations)
    steps = range(1, min(NEIGHBOURS, len(seconds) - 1) + 1)
    first = np.concatenate([np.arange(len(seconds) - step) for step in steps])
    second = np.concatenate([np.arange(step, len(seconds)) for step in steps])
    seen = pose.rotation_angle(boards[first] @ pose.inverse(boards[second]))
    tried = np.arange(-LARGEST_S, LARGEST_S + STEP_S / 2, STEP_S)
    costs = []
    for latency in tried:
        flanges = clocked.track.at(seconds - latency)
        turned = pose.rotation_angle(pose.inverse(flanges[first]) @ flanges[second])
        costs.append(float(np.minimum(np.abs(seen - turned), LARGEST_TURN).mean()))
    best, zero = int(np.argmin(costs)), int(np.abs(tried).argmin())
    return float(tried[best]) if costs[best] < CLEARLY * costs[zero] else 0.0


def _all(observations: tuple[Observation, ...], clocked: Clocked) -> tuple[tuple[Observation, ...], Array]:
    """Observations of the session and of motion in the order of time, and their stamps since the first pose [s]."""
    stamps = np.concatenate([clocked.stamps_ns, clocked.moving_ns])
    every, order = (*observations, *clocked.moving), np.argsort(stamps, kind="stable")
    return tuple(every[one] for one in order), clocked.track.seconds(stamps[order])


def find(fit: outliers.Fit, free: tuple[str, ...], start_s: float) -> Latency | None:
    """The latency by all pictures of a session, from a refinement of its rig and a first guess [s].

    Returns None if it cannot be told: too few pictures of a moving arm show the target, or the arm moves too little.
    """
    session, measured, refined = fit.session, fit.measured, fit.refined
    clocked = session.clocked
    assert clocked is not None
    observations, seconds = _all(session.observations, clocked)
    moving = len(clocked.moving) if clocked.halts else len(observations)
    if moving < FEWEST:
        return None
    track = clocked.track
    whole = replace(session, observations=observations, base_from_flange=track.at(seconds - start_s), clocked=None, joints=None)
    late = LateMeasurements(model.measured(whole, free, measured.known, measured.accuracy, measured.form), track, seconds)
    rig = replace(refined.state, corrections=np.zeros((len(observations), 6)))
    try:
        found = refine.refine(late, Late(rig, start_s), sigma_px=refined.sigmas.pixel)
        covariance = covariance_of(found.information)
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    std = float(np.sqrt(covariance[-1, -1]))
    if not std < LARGEST_STD_S:
        return None
    by_rig = covariance[:-1, -1] / covariance[-1, -1] * (not clocked.halts)
    return Latency(found.state.latency_s, std, moving, by_rig, _speed_px(late, found.state))


def _speed_px(late: LateMeasurements, state: Late) -> float:
    """Median speed of the corners of the faster half of the pictures [px/s]."""
    _, by_global, _ = late.predicted(state)
    speed: Any = np.linalg.norm(by_global[..., -1], axis=1)
    return float(np.median(speed[speed >= np.median(speed)]))
