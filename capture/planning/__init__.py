"""Planning: joint angles for each view, and collision-free paths between them."""

from koala3d.capture.planning.durations import arrivals, duration, fastest
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.pace import FIRST_RAD_S, Pace, move_duration
from koala3d.capture.planning.plan import PlannedView, blocked, connect, plan

__all__ = [
    "FIRST_RAD_S",
    "Obstacles",
    "Pace",
    "PlannedView",
    "arrivals",
    "blocked",
    "connect",
    "duration",
    "fastest",
    "move_duration",
    "plan",
]
