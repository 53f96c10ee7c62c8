"""Times of moves and sessions, worked by hand."""

import numpy as np
import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import Motion, Trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning import PlannedView, arrivals, duration, move_duration

FREE = RigDescription.model_validate({"robot": {"max_tool_speed": 3.0}}).carrier()
"""A rig whose limit of the body's speed does not bind here."""
MOTION = Motion(speed=1.0, acceleration=2.0, settle_time_s=0.5)


@pytest.mark.parametrize(
    ("travel", "seconds"),
    [
        (0.0, 0.0),
        (0.02, 0.2),  # 0.1 s up and down, never at full speed: 2 sqrt(0.02 / 2)
        (0.5, 1.0),  # just reaches 1 rad/s after 0.5 s
        (2.0, 2.5),  # 0.5 s up, 1.5 rad at full speed, 0.5 s down
    ],
)
def test_a_move_has_a_trapezoidal_speed(travel: float, seconds: float) -> None:
    assert move_duration(MOTION, travel) == pytest.approx(seconds)


def session() -> tuple[Trajectory, list[PlannedView]]:
    trajectory = Trajectory.model_validate(
        {
            "name": "two",
            "views": [{"kind": "joints", "joints_deg": [[0.0] * 6, [0.0] * 6]}],
            "motion": {"speed": 1.0, "acceleration": 2.0, "settle_time_s": 0.5},
            "camera": {"exposure_us": 20_000},
        }
    )
    first, corner, last = np.zeros(6), np.eye(6)[0] * 2.0, np.eye(6)[0] * 2.0 + np.eye(6)[3] * 0.5
    views = [PlannedView(Viewpoint(name="000"), first, [first]), PlannedView(Viewpoint(name="001"), last, [corner, last])]
    return trajectory, views


def test_arrivals_add_moves_settling_and_exposures() -> None:
    first, second = arrivals(*session(), FREE)
    np.testing.assert_allclose(first, [0.0, 0.62])  # settles for 0.5 s, exposes for 0.02 s, reads for 0.1 s
    np.testing.assert_allclose(second, [0.62 + 2.5, 3.62, 3.62 + 1.0, 5.24])


def test_the_duration_is_the_end_of_the_last_view() -> None:
    trajectory, views = session()
    assert duration(trajectory, views, FREE) == pytest.approx(5.24) and duration(trajectory, [], FREE) == 0.0
