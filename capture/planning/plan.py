"""From the views of a trajectory to joint angles: every branch and roll of each view, the shortest sequence through all."""

import itertools
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture import kinematics
from capture.errors import PlanningError, UnreachableError
from capture.planning.obstacles import Obstacles
from capture.planning.order import short_order
from capture.planning.ways import are_free, find_way
from capture.viewpoints import Viewpoint
from datasets import pose

Joints = NDArray[np.float64]

HOME = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])
"""The arm stretched upwards; each joint stays within a turn of it [rad]."""
MIN_SINGULARITY = 0.03
"""Views nearer to a singular configuration are not taken; see `kinematics.singularity`."""
DETOUR = 4.0
"""Cost of a way that is not straight, in radians of the fastest joint."""


@dataclass(frozen=True)
class PlannedView:
    """A view, the joint angles that take it, and the way there."""

    viewpoint: Viewpoint
    """With the camera pose that was chosen among the rolls that were allowed."""
    joints: Joints
    """(6,) [rad] by the nominal kinematics and the nominal camera mount."""
    way: list[Joints]
    """Joint angles to pass through from the previous view, the last being `joints`; just `[joints]` for the first."""


@dataclass(frozen=True)
class _Candidates:
    joints: Joints  # (n, 6)
    rolls: NDArray[np.int64]  # (n,)


def plan(trajectory: Any, flange_from_camera: NDArray[np.float64], *, without: Collection[str] = ()) -> list[PlannedView]:
    """Joint angles for every view of a `Trajectory`, in the order in which to take them, with collision-free ways between.

    That is the order of the trajectory; with `motion.order` "shortest" another one, where it saves time. The result depends on the
    arguments alone, so that a session can be repeated and resumed.

    Args:
        trajectory: what to take.
        flange_from_camera: (4, 4) nominal camera mount [m].
        without: names of views to leave out.

    Raises:
        UnreachableError: names each view that cannot be taken, and the limit that it meets.
        PlanningError: no way between two views was found.
    """
    obstacles = Obstacles.of(trajectory, flange_from_camera)
    viewpoints = [viewpoint for viewpoint in trajectory.viewpoints() if viewpoint.name not in without]
    layers, failures = [], []
    for viewpoint in viewpoints:
        candidates, reason = _candidates(viewpoint, obstacles)
        layers.append(candidates)
        if reason:
            failures.append(f"{viewpoint.name}: {reason}")
    if failures:
        shown = "; ".join(failures[:5]) + (f"; and {len(failures) - 5} more" if len(failures) > 5 else "")
        raise UnreachableError(
            f"{len(failures)} of {len(viewpoints)} views cannot be taken", where=trajectory.name, why=shown,
            remedy="move the target, change distance or elevation, or allow more roll_deg",
        )  # fmt: skip
    chosen, cost = _shortest([layer.joints for layer in layers], obstacles)
    if trajectory.motion.order == "shortest":
        order = short_order(np.stack([_pose(viewpoint, flange_from_camera) for viewpoint in viewpoints]))
        other, other_cost = _shortest([layers[index].joints for index in order], obstacles)
        if other_cost < cost:
            chosen, viewpoints, layers = other, [viewpoints[i] for i in order], [layers[i] for i in order]
    return _with_ways(viewpoints, layers, chosen, obstacles)


def _with_ways(
    viewpoints: list[Viewpoint], layers: list[_Candidates], chosen: list[int], obstacles: Obstacles
) -> list[PlannedView]:
    """The chosen configuration of each view, and the way there from the one before."""
    planned: list[PlannedView] = []
    previous = None
    for viewpoint, layer, index in zip(viewpoints, layers, chosen, strict=True):
        joints = layer.joints[index]
        way = [joints] if previous is None else connect(previous, joints, obstacles, where=f"view {viewpoint.name}")
        planned.append(
            PlannedView(_rolled(viewpoint, int(layer.rolls[index]), joints, obstacles.flange_from_camera), joints, way)
        )
        previous = joints
    return planned


def connect(start: Joints, goal: Joints, obstacles: Obstacles, *, where: str = "") -> list[Joints]:
    """Joint angles to pass through after `start`, the last being `goal`, clear of all obstacles.

    Raises:
        PlanningError: no way was found.
    """
    way = find_way(np.asarray(start, np.float64), np.asarray(goal, np.float64), obstacles)
    if way is None:
        pair, room = obstacles.nearest(start)
        state = f"the arm stands too near already: {pair}, {room * 1000:.0f} mm" if room < 0 else "2000 tries"
        raise PlanningError("no way around the obstacles was found", where=where, why=state,
                            remedy="move the arm to an open pose by hand, or lower safety.clearance_m")  # fmt: skip
    return way


def move_duration(motion: Any, travel: float) -> float:
    """Time [s] in which the fastest joint goes `travel` [rad] with a trapezoidal profile of a trajectory's `motion`."""
    ramp = motion.speed**2 / motion.acceleration
    return float(2 * np.sqrt(travel / motion.acceleration) if travel < ramp else (travel + ramp) / motion.speed)


def duration(trajectory: Any, planned: list[PlannedView]) -> float:
    """Time that a session takes on the real arm [s]: trapezoidal moves between the views, settling and exposures."""
    motion, seconds, previous = trajectory.motion, 0.0, None
    for view in planned:
        for joints in view.way:
            seconds += move_duration(motion, 0.0 if previous is None else float(np.abs(joints - previous).max()))
            previous = joints
        seconds += len(view.way) * motion.settle_time_s + trajectory.camera.exposure_us * 1e-6 + 0.1
    return float(seconds)


def blocked(trajectory: Any, flange_from_camera: NDArray[np.float64]) -> dict[str, str]:
    """Views of a `Trajectory` that the arm cannot take: name to the limit that each meets; empty where it can take all."""
    obstacles = Obstacles.of(trajectory, flange_from_camera)
    reasons = {viewpoint.name: _candidates(viewpoint, obstacles)[1] for viewpoint in trajectory.viewpoints()}
    return {name: reason for name, reason in reasons.items() if reason}


def _candidates(viewpoint: Viewpoint, obstacles: Obstacles) -> tuple[_Candidates, str]:
    """Every configuration that takes the view; where there is none, the reason."""
    camera_from_flange = pose.inverse(obstacles.flange_from_camera)
    if viewpoint.joints is not None:
        joints, rolls = viewpoint.joints[None], np.zeros(1, np.int64)
        if np.abs(joints).max() > kinematics.JOINT_LIMIT:
            worst = int(np.abs(joints[0]).argmax())
            return _Candidates(joints, rolls), f"joint {worst + 1} at {np.degrees(joints[0, worst]):.0f} degrees, limit 360"
    else:
        assert viewpoint.base_from_camera is not None  # a viewpoint has either
        flanges = [_turned(viewpoint.base_from_camera, roll) @ camera_from_flange for roll in viewpoint.rolls]
        branches = [kinematics.inverse(base_from_flange) for base_from_flange in flanges]
        joints = np.concatenate(branches)
        rolls = np.repeat(np.arange(len(branches)), [len(b) for b in branches])
        if not len(joints):
            return _Candidates(joints, rolls), _too_far(flanges)
    margin = obstacles.margin(joints)
    if (margin < 0).all():
        pair, room = obstacles.nearest(joints[int(margin.argmax())])
        return _Candidates(joints, rolls), f"{pair} too near, {-room * 1000:.0f} mm beyond the clearance"
    if viewpoint.joints is not None:
        return _Candidates(joints, rolls), ""
    joints, rolls = joints[margin >= 0], rolls[margin >= 0]
    sight = obstacles.sight(joints)
    if (sight < 0).all():
        return _Candidates(joints, rolls), f"{obstacles.hiding(joints[int(sight.argmax())])} hides the object from the camera"
    keep = (sight >= 0) & (np.array([kinematics.singularity(q) for q in joints]) >= MIN_SINGULARITY)
    if not keep.any():
        return _Candidates(joints, rolls), "only next to a singular configuration"
    return _with_turns(joints[keep], rolls[keep]), ""


def _with_turns(joints: Joints, rolls: NDArray[np.int64]) -> _Candidates:
    """Each configuration near home, and with the base or the last wrist joint a turn further, where the limits allow."""
    joints = kinematics.nearest_turn(joints, HOME)
    shifts = [np.array([a, 0, 0, 0, 0, b]) * 2 * np.pi for a in (0, -1, 1) for b in (0, -1, 1)]
    turned = np.concatenate([joints + shift for shift in shifts])
    inside = (np.abs(turned) <= kinematics.JOINT_LIMIT - 0.05).all(axis=1)
    return _Candidates(turned[inside], np.tile(rolls, len(shifts))[inside])


def _too_far(flanges: list[NDArray[np.float64]]) -> str:
    """Why no branch exists: the centre of the wrist must lie within the reach of upper arm and forearm."""
    wrist = np.array([flange[:3, 3] - kinematics.UR5E.d[5] * flange[:3, 2] for flange in flanges])
    distance = np.linalg.norm(wrist - [0, 0, kinematics.UR5E.d[0]], axis=1)
    nearest = float(distance.min())
    if nearest > 0.5:
        return f"out of reach, wrist {nearest:.2f} m from the shoulder, limit about {kinematics.REACH:.2f} m"
    return f"too near to the base, wrist {nearest:.2f} m from the shoulder"


def _turned(base_from_camera: NDArray[np.float64], roll: float) -> NDArray[np.float64]:
    return base_from_camera @ pose.from_rotation_vector([0, 0, roll])


def _pose(viewpoint: Viewpoint, flange_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) camera pose that a view asks for [m], whatever its roll."""
    if viewpoint.base_from_camera is not None:
        return viewpoint.base_from_camera
    assert viewpoint.joints is not None  # a viewpoint has either
    return kinematics.forward(viewpoint.joints) @ flange_from_camera


def _rolled(viewpoint: Viewpoint, roll: int, joints: Joints, flange_from_camera: NDArray[np.float64]) -> Viewpoint:
    if viewpoint.base_from_camera is None:
        return replace(viewpoint, base_from_camera=kinematics.forward(joints) @ flange_from_camera)
    turned = _turned(viewpoint.base_from_camera, viewpoint.rolls[roll])
    return replace(viewpoint, base_from_camera=turned, rolls=(0.0,))


def _shortest(layers: list[Joints], obstacles: Obstacles) -> tuple[list[int], float]:
    """Index into each layer of (n, 6) configurations, and the cost [rad]: the sequence with the least travel of the fastest joint.

    Collisions are looked for only on the ways of the best sequence so far; one that is blocked is charged a detour
    and the search repeated, until nothing on the best sequence is unknown.
    """
    costs = [np.abs(a[:, None] - b[None]).max(-1) + 0.05 * np.abs(a[:, None] - b[None]).sum(-1)
             for a, b in itertools.pairwise(layers)]  # fmt: skip
    known = [np.zeros(cost.shape, bool) for cost in costs]
    while True:
        chosen = _cheapest(layers, costs)
        unknown = [i for i in range(len(costs)) if not known[i][chosen[i], chosen[i + 1]]]
        if not unknown:
            return chosen, float(sum(cost[a, b] for cost, (a, b) in zip(costs, itertools.pairwise(chosen), strict=True)))
        starts = np.stack([layers[i][chosen[i]] for i in unknown])
        goals = np.stack([layers[i + 1][chosen[i + 1]] for i in unknown])
        for i, free in zip(unknown, are_free(starts, goals, obstacles), strict=True):
            known[i][chosen[i], chosen[i + 1]] = True
            if not free:
                costs[i][chosen[i], chosen[i + 1]] += DETOUR


def _cheapest(layers: list[Joints], costs: list[NDArray[np.float64]]) -> list[int]:
    total, back = np.abs(layers[0] - HOME).max(-1), []
    for cost in costs:
        through = total[:, None] + cost
        back.append(through.argmin(axis=0))
        total = through.min(axis=0)
    chosen = [int(total.argmin())]
    for previous in back[::-1]:
        chosen.append(int(previous[chosen[-1]]))
    return chosen[::-1]
