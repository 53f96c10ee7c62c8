"""Planning: joint angles for each view, and collision-free paths between them."""

from capture.planning.durations import arrivals, duration, move_duration
from capture.planning.obstacles import Obstacles
from capture.planning.plan import PlannedView, blocked, connect, plan

__all__ = ["Obstacles", "PlannedView", "arrivals", "blocked", "connect", "duration", "move_duration", "plan"]
