"""Planning: joint angles for each view, and collision-free paths between them."""

from koala3d.capture.planning.durations import arrivals, duration, move_duration
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.plan import PlannedView, blocked, connect, plan

__all__ = ["Obstacles", "PlannedView", "arrivals", "blocked", "connect", "duration", "move_duration", "plan"]
