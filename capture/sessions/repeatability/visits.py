"""Visits to a few views of the target, round after round, each from the same side: what measures how well the arm comes back."""

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.drivers.errors import UnreachableError
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import JointViews
from koala3d.capture.planning import Obstacles, PlannedView, connect
from koala3d.capture.sessions.calibrate.candidates import looking

Array = NDArray[np.float64]

PICTURES = 2
"""Pictures of each visit, while the arm stands still: how far they differ is what the pictures themselves are uncertain by."""


def visits_to(trajectory: Trajectory, carrier: Carrier, visits: int, views: int) -> Trajectory:
    """A trajectory of `visits` rounds through up to `views` of the views that the arm can take, evenly spread.

    Raises UnreachableError: it can take fewer than two.
    """
    places = looking(trajectory, carrier, carrier.arm.home, views)
    if len(places) < 2:
        remedy = "see 'capture plan'; move the target to where the arm reaches it"
        why = f"{len(places)} of the views that were tried can be taken"
        raise UnreachableError("the arm has to move between two views at least", where=trajectory.name, why=why, remedy=remedy)
    once = [np.degrees(joints).tolist() for joints in places for _ in range(PICTURES)]
    group = JointViews(kind="joints", joints_deg=once * visits)
    return trajectory.model_copy(update={"views": [group], "split": None})


def planned_visits(trajectory: Trajectory, carrier: Carrier) -> list[PlannedView]:
    """The plan of `visits_to`: each path between two places is found once.

    Raises PlanningError: no path leads from one of them to the next.
    """
    obstacles, views = Obstacles.of(trajectory, carrier), trajectory.viewpoints()
    joints = [np.asarray(view.joints, np.float64) for view in views]
    found: dict[tuple[bytes, bytes], list[Array]] = {}
    planned = [PlannedView(views[0], joints[0], [joints[0]])]
    for view, start, goal in zip(views[1:], joints, joints[1:], strict=False):
        key = (start.tobytes(), goal.tobytes())
        if key not in found:
            found[key] = connect(start, goal, obstacles, where=f"view {view.name}")
        planned.append(PlannedView(view, goal, found[key]))
    return planned
