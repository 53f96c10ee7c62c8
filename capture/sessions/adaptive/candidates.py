"""Views that the arm can take: those of a trajectory, packed more densely, and checked by the planner."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.trajectory import Trajectory, Views
from koala3d.capture.model.viewpoints import HemisphereViews, OrbitViews, Viewpoint
from koala3d.capture.planning import Obstacles
from koala3d.capture.planning.solutions import Solutions, solve
from koala3d.capture.sessions.adaptive.gain import Seen
from koala3d.capture.sessions.adaptive.places import Places
from koala3d.capture.sessions.adaptive.sight import Eye, facing, whichever_way_up
from koala3d.datasets.camera_model import Camera

Array = NDArray[np.float64]

COUNT = 200
"""Views that are looked at, about; the arm may be unable to take some of them."""


@dataclass(frozen=True, eq=False)
class ReachableView:
    """One view that the arm can take."""

    solutions: Solutions
    base_from_camera: Array
    """(4, 4) nominal pose, before any roll [m]."""

    def nearest(self, present: Array) -> int:
        """Index of the configuration that needs the shortest motion of the fastest joint from (n,) angles [rad]."""
        return int(np.abs(self.solutions.joints - present).max(axis=1).argmin())


def dense(trajectory: Trajectory, count: int = COUNT) -> list[Viewpoint]:
    """About `count` views where those of a trajectory are: hemispheres and orbits with more views, other groups as they are."""
    factor = max(count / trajectory.number, 1.0)
    return [view for group in trajectory.views for view in _denser(group, factor).generate(trajectory.upwards)]


def _denser(group: Views, factor: float) -> Views:
    if isinstance(group, HemisphereViews):
        rings = round(group.rings * factor**0.5) if group.elevation_deg[0] < group.elevation_deg[1] else group.rings
        return group.model_copy(update={"count": round(group.count * factor), "rings": rings})
    if isinstance(group, OrbitViews):
        return group.model_copy(update={"count": round(group.count * factor)})
    return group


def within_reach(
    viewpoints: list[Viewpoint], obstacles: Obstacles, done: Callable[[], None] = lambda: None
) -> tuple[list[ReachableView], list[str]]:
    """The views that the arm can take, and for each of the others the reason; `done` is called after each."""
    found, reasons = [], []
    for viewpoint in viewpoints:
        solved = solve(viewpoint, obstacles)
        if solved.reason:
            reasons.append(solved.reason)
        else:
            found.append(ReachableView(solved, viewpoint.camera_pose(obstacles.carrier)))
        done()
    return found, reasons


def see(candidates: list[ReachableView], places: Places, obstacles: Obstacles, eye: Eye, camera: Camera | None) -> Seen:
    """How the candidates see the places. Of a picture's longer side only the middle counts: a roll may turn it."""
    square = None if camera is None else whichever_way_up(camera)
    poses = [eye(obstacles.flange_for(one.base_from_camera), one.solutions.joints[0]) for one in candidates]
    return seen_from(np.stack(poses), places, square)


def seen_from(base_from_camera: Array, places: Places, camera: Camera | None) -> Seen:
    """How cameras at (m, 4, 4) poses [m] see the places."""
    rows = [facing(places, one, camera) for one in base_from_camera]
    return Seen(np.stack(rows) if rows else np.zeros((0, len(places.points)), np.float32), base_from_camera[:, :3, 3])
