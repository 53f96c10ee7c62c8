"""Which joint angles take each view, and how the arm gets from one to the next without touching anything."""

from capture.planning.obstacles import Obstacles
from capture.planning.plan import PlannedView, blocked, connect, duration, move_duration, plan

__all__ = ["Obstacles", "PlannedView", "blocked", "connect", "duration", "move_duration", "plan"]
