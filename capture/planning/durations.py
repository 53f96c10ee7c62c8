"""How long a planned session takes on the real arm: moves with trapezoidal speed, settling, exposures."""

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning.pace import Pace, paces
from koala3d.capture.planning.plan import PlannedView

READOUT_S = 0.1  # time from the end of an exposure to the start of the next motion


def arrivals(trajectory: Trajectory, planned: list[PlannedView], carrier: Carrier) -> list[list[float]]:
    """For each view, the arrival at and the departure from each corner of its path [s]. The last is the end of the session.

    It begins at the first view. The table turns after the arm has arrived.
    """
    motion, table, now, found = trajectory.motion, carrier.turntable, 0.0, []
    angle = 0.0
    for view, moves in zip(planned, _moves(trajectory, planned, carrier), strict=True):
        times: list[float] = []
        for seconds in [one.seconds for one in moves] or [0.0]:
            now += seconds
            times += [now, now + motion.settle_time_s]
            now = times[-1]
        turned = angle if view.viewpoint.turntable is None else view.viewpoint.turntable
        now, angle = now + (0.0 if table is None else table.duration(turned - angle)), turned
        times[-1] = now = now + trajectory.camera.exposure_us * 1e-6 + READOUT_S
        found.append(times)
    return found


def _moves(trajectory: Trajectory, planned: list[PlannedView], carrier: Carrier) -> list[list[Pace]]:
    """The moves to each view; none to the first one."""
    ends = [view.joints for view in planned]
    starts = [[]] if planned else []
    return starts + [
        paces([end, *view.path], trajectory.motion, carrier) for end, view in zip(ends[:-1], planned[1:], strict=True)
    ]


def duration(trajectory: Trajectory, planned: list[PlannedView], carrier: Carrier) -> float:
    """Estimated length of a session [s], from the first view on."""
    return arrivals(trajectory, planned, carrier)[-1][-1] if planned else 0.0


def fastest(trajectory: Trajectory, planned: list[PlannedView], carrier: Carrier) -> float:
    """Speed of the fastest point of the body in a session [m/s], from the first view on."""
    return max((one.point_speed for moves in _moves(trajectory, planned, carrier) for one in moves), default=0.0)
