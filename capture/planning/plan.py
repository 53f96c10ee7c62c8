"""The plan of a session: joint angles for every view, and the paths between them."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from koala3d.capture.drivers.errors import PlanningError, UnreachableError
from koala3d.capture.model.built import BuiltArm
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.order import short_order
from koala3d.capture.planning.paths import find_path
from koala3d.capture.planning.sequence import shortest
from koala3d.capture.planning.solutions import Joints, Solutions, solve

SHOWN = 5  # views that an error lists with their reasons


@dataclass(frozen=True)
class PlannedView:
    """A view, the joint angles that take it, and the path to them."""

    viewpoint: Viewpoint  # with the camera pose of the chosen roll
    joints: Joints  # (n,) [rad] by the nominal kinematics and the nominal camera mount
    path: list[Joints]
    """Joint angles to pass through from the previous view, the last being `joints`; only `joints` for the first view."""


def plan(
    trajectory: Trajectory, mount: Carrier, *, without: Collection[str] = (), nominal: list[PlannedView] | None = None
) -> list[PlannedView]:
    """Joint angles for every view of a trajectory, in the order of capture, with collision-free paths between them.

    The order is that of the trajectory, or with `motion.order` "shortest" another one if it saves time. The result depends
    only on the arguments, so that a session can be repeated and resumed. The limit of the cable decides how the arm takes a view,
    and never how the picture is rolled if it can be helped: rigs with and without a limit take the same pictures. So do arms of
    one model: the plan for an arm as built is the one for the nominal links, brought onto the same poses.

    Args:
        mount: the arm and its camera.
        without: names of views to leave out.
        nominal: the plan for the nominal links of the arm, if it has been made already.

    Raises:
        UnreachableError: names the views that cannot be taken, and why.
        PlanningError: no path between two views was found.
    """
    if mount.built is not None:
        nominal = plan(trajectory, replace(mount, built=None), without=without) if nominal is None else nominal
        return _as_built(trajectory, mount.built, mount, nominal)
    obstacles = Obstacles.of(trajectory, mount)
    loose = replace(obstacles, carrier=replace(mount, cable=None))
    solved = [solve(viewpoint, loose) for viewpoint in trajectory.viewpoints() if viewpoint.name not in without]
    _require_reached(solved, trajectory.name)
    chosen, cost = shortest([one.joints for one in solved], loose)
    if trajectory.motion.order == "shortest":
        order = short_order(np.stack([one.viewpoint.camera_pose(obstacles.carrier) for one in solved]))
        reordered = [solved[index] for index in order]
        other, other_cost = shortest([one.joints for one in reordered], loose)
        if other_cost < cost:
            chosen, solved = other, reordered
    if mount.cable is not None and not all(mount.permitted(one.joints[i]) for one, i in zip(solved, chosen, strict=True)):
        solved = [one.within(mount, roll=int(one.rolls[index])) for one, index in zip(solved, chosen, strict=True)]
        _require_reached(solved, trajectory.name)
        chosen, _ = shortest([one.joints for one in solved], obstacles)
    return _with_paths(solved, chosen, obstacles)


def _as_built(trajectory: Trajectory, built: BuiltArm, mount: Carrier, nominal: list[PlannedView]) -> list[PlannedView]:
    """The nominal plan for an arm with links of its own: each view in the same configuration, with paths that are checked anew.

    If the arm as it is would be too close there, the view is taken in another configuration, and if need be with another roll.
    """
    obstacles, wanted = Obstacles.of(trajectory, mount), {view.name: view for view in trajectory.viewpoints()}
    solved, chosen = [], []
    for planned in nominal:
        view, rolled = wanted[planned.viewpoint.name], planned.viewpoint
        found = solve(view, obstacles) if view.joints is not None else None
        if found is None:
            near = built.near(obstacles.flange_for(rolled.camera_pose(mount)), planned.joints)
            same = len(near) > 0 and bool(obstacles.free(near)[0])
            found = Solutions(rolled, near, np.zeros(1, np.int64)) if same else solve(rolled, obstacles)
            found = solve(view, obstacles) if found.reason else found
        solved.append(found)
        chosen.append(0 if found.reason else int(np.abs(found.joints - planned.joints).max(axis=1).argmin()))
    _require_reached(solved, trajectory.name)
    return _with_paths(solved, chosen, obstacles)


def _require_reached(solved: list[Solutions], where: str) -> None:
    """Raise UnreachableError if views have no solution."""
    failures = [f"{one.viewpoint.name}: {one.reason}" for one in solved if one.reason]
    if failures:
        more = f"; and {len(failures) - SHOWN} more" if len(failures) > SHOWN else ""
        raise UnreachableError(
            f"{len(failures)} of {len(solved)} views cannot be taken",
            where=where,
            why="; ".join(failures[:SHOWN]) + more,
            remedy="move the target, change distance or elevation, or allow more values of roll_deg",
        )


def _with_paths(solved: list[Solutions], chosen: list[int], obstacles: Obstacles) -> list[PlannedView]:
    """The chosen configuration of each view, and the path from the previous one."""
    planned: list[PlannedView] = []
    for one, index in zip(solved, chosen, strict=True):
        joints, view = one.joints[index], one.taken_by(index, obstacles.carrier)
        path = connect(planned[-1].joints, joints, obstacles, where=f"view {view.name}") if planned else [joints]
        planned.append(PlannedView(view, joints, path))
    return planned


def connect(start: Joints, goal: Joints, obstacles: Obstacles, *, where: str = "") -> list[Joints]:
    """Joint angles to pass through after `start`, the last being `goal`, clear of all obstacles.

    Raises PlanningError: no path was found.
    """
    path = find_path(np.asarray(start, np.float64), np.asarray(goal, np.float64), obstacles)
    if path is None:
        pair, room = obstacles.nearest(start)
        beyond = next(filter(None, (obstacles.carrier.forbidden(joints) for joints in (start, goal))), "")
        state = f"the arm is already too close: {pair}, {room * 1000:.0f} mm" if room < 0 else beyond or "2000 tries"
        remedy = "move the arm to an open pose by hand, or lower safety.clearance_m"
        raise PlanningError("no path around the obstacles was found", where=where, why=state, remedy=remedy)
    return path


def blocked(trajectory: Trajectory, mount: Carrier) -> dict[str, str]:
    """The views of a trajectory that the arm cannot take, with the reasons; empty if it can take all."""
    obstacles = Obstacles.of(trajectory, mount)
    solved = [solve(viewpoint, obstacles) for viewpoint in trajectory.viewpoints()]
    return {one.viewpoint.name: one.reason for one in solved if one.reason}
