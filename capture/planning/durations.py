"""How long a planned session takes on the real arm: moves with trapezoidal speed, settling, exposures."""

import numpy as np

from koala3d.capture.model.trajectory import Motion, Trajectory
from koala3d.capture.model.turntable import TurntableDescription
from koala3d.capture.planning.plan import PlannedView

READOUT_S = 0.1  # time from the end of an exposure to the start of the next motion


def move_duration(motion: Motion, travel: float) -> float:
    """Time [s] of a move of the fastest joint by `travel` [rad] with a trapezoidal speed profile."""
    ramp = motion.speed**2 / motion.acceleration
    return float(2 * np.sqrt(travel / motion.acceleration) if travel < ramp else (travel + ramp) / motion.speed)


def arrivals(
    trajectory: Trajectory, planned: list[PlannedView], turntable: TurntableDescription | None = None
) -> list[list[float]]:
    """For each view, the arrival at and the departure from each corner of its path [s]. The last is the end of the session.

    The table turns after the arm has arrived.
    """
    motion, now, previous, found = trajectory.motion, 0.0, None, []
    angle = 0.0
    for view in planned:
        times: list[float] = []
        for corner in view.path:
            now += move_duration(motion, 0.0 if previous is None else float(np.abs(corner - previous).max()))
            times += [now, now + motion.settle_time_s]
            now, previous = times[-1], corner
        turned = angle if view.viewpoint.turntable is None else view.viewpoint.turntable
        now, angle = now + (0.0 if turntable is None else turntable.duration(turned - angle)), turned
        times[-1] = now = now + trajectory.camera.exposure_us * 1e-6 + READOUT_S
        found.append(times)
    return found


def duration(trajectory: Trajectory, planned: list[PlannedView], turntable: TurntableDescription | None = None) -> float:
    """Estimated length of a session [s]."""
    return arrivals(trajectory, planned, turntable)[-1][-1] if planned else 0.0
