"""The first views of a session that chooses its own: spread over those of the trajectory, and the trajectory's test views."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning import Obstacles, plan
from koala3d.capture.sessions.adaptive.candidates import within_reach

Array = NDArray[np.float64]

FIRST = 10
"""Training views with which a session begins."""


@dataclass(frozen=True, eq=False)
class TourView:
    """One of the first views."""

    joints: Array
    use: Literal["train", "test"]


def tour(trajectory: Trajectory, carrier: Carrier) -> tuple[list[TourView], int]:
    """The first views in a short order, and how many test views of the trajectory cannot be taken.

    Depends only on the arguments, so that a session can be resumed in it. Raises UnreachableError: no training view can be taken.
    """
    views = trajectory.viewpoints()
    found, reasons = within_reach(views, Obstacles.of(trajectory, carrier))
    able = [one.solutions.viewpoint for one in found]
    train, test = ([view for view in able if view.split == split] for split in ("train", "test"))
    if not train:
        why = reasons[0] if reasons else ""
        raise UnreachableError("no training view can be taken", where=trajectory.name, why=why, remedy="see 'capture plan'")
    places = np.stack([view.camera_pose(carrier)[:3, 3] for view in train])
    first = {train[index].name for index in far_apart(places, FIRST)}
    wanted = first | {view.name for view in test}
    short = trajectory.model_copy(update={"motion": trajectory.motion.model_copy(update={"order": "shortest"})})
    planned = plan(short, carrier, without=[view.name for view in views if view.name not in wanted])
    tests = sum(split == "test" for split in trajectory.splits)
    stops = [TourView(view.joints, "test" if view.viewpoint.split == "test" else "train") for view in planned]
    return stops, tests - len(test)


def far_apart(points: Array, count: int) -> list[int]:
    """Indices of `count` of (n, 3) points, each the one furthest from those before it; the first is the point 0."""
    chosen, distance = [0], np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen
