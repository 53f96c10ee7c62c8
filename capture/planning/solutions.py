"""The configurations of the arm that take one view, or the reason why there is none."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture import kinematics
from capture.planning.obstacles import Obstacles
from capture.viewpoints import Viewpoint
from datasets import pose

Joints = NDArray[np.float64]

HOME = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])
"""The arm stretched upwards; each joint stays within one turn of it [rad]."""
MIN_SINGULARITY = 0.03  # configurations closer to a singularity are not used; see `kinematics.singularity`


@dataclass(frozen=True)
class Solutions:
    """The configurations that take one view."""

    viewpoint: Viewpoint
    joints: Joints  # (n, 6) [rad]
    rolls: NDArray[np.int64]  # (n,) index of the roll of the view that each of them takes
    reason: str = ""  # why none of them can be used; empty if all can

    def taken_by(self, index: int, flange_from_camera: NDArray[np.float64]) -> Viewpoint:
        """The view with the camera pose that one of the configurations reaches."""
        wanted = self.viewpoint
        if wanted.base_from_camera is None:
            return replace(wanted, base_from_camera=kinematics.forward(self.joints[index]) @ flange_from_camera)
        turned = _turned(wanted.base_from_camera, wanted.rolls[int(self.rolls[index])])
        return replace(wanted, base_from_camera=turned, rolls=(0.0,))


def solve(viewpoint: Viewpoint, obstacles: Obstacles) -> Solutions:
    """Every configuration that takes the view and is clear of the obstacles; without any, the reason."""
    if viewpoint.joints is not None:
        return _check_given(viewpoint, viewpoint.joints[None], obstacles)
    assert viewpoint.base_from_camera is not None  # a viewpoint has either
    camera_from_flange = pose.inverse(obstacles.flange_from_camera)
    flanges = [_turned(viewpoint.base_from_camera, roll) @ camera_from_flange for roll in viewpoint.rolls]
    branches = [kinematics.inverse(base_from_flange) for base_from_flange in flanges]
    joints = np.concatenate(branches)
    rolls = np.repeat(np.arange(len(branches)), [len(b) for b in branches])
    if not len(joints):
        return Solutions(viewpoint, joints, rolls, _out_of_reach(flanges))
    margin = obstacles.margin(joints)
    if (margin < 0).all():
        return Solutions(viewpoint, joints, rolls, _too_close(joints[int(margin.argmax())], obstacles))
    joints, rolls = joints[margin >= 0], rolls[margin >= 0]
    sight = obstacles.sight(joints)
    if (sight < 0).all():
        hiding = obstacles.hiding(joints[int(sight.argmax())])
        return Solutions(viewpoint, joints, rolls, f"{hiding} hides the object from the camera")
    keep = (sight >= 0) & (np.array([kinematics.singularity(q) for q in joints]) >= MIN_SINGULARITY)
    if not keep.any():
        return Solutions(viewpoint, joints, rolls, "only next to a singular configuration")
    return _with_turns(viewpoint, joints[keep], rolls[keep])


def _check_given(viewpoint: Viewpoint, joints: Joints, obstacles: Obstacles) -> Solutions:
    """A view whose joint angles are given, (1, 6)."""
    reason = ""
    worst = int(np.abs(joints[0]).argmax())
    if abs(joints[0, worst]) > kinematics.JOINT_LIMIT:
        reason = f"joint {worst + 1} at {np.degrees(joints[0, worst]):.0f} degrees, limit 360"
    elif obstacles.margin(joints)[0] < 0:
        reason = _too_close(joints[0], obstacles)
    return Solutions(viewpoint, joints, np.zeros(1, np.int64), reason)


def _too_close(joints: Joints, obstacles: Obstacles) -> str:
    pair, room = obstacles.nearest(joints)
    return f"{pair} too close, {-room * 1000:.0f} mm inside the clearance"


def _out_of_reach(flanges: list[NDArray[np.float64]]) -> str:
    """Why there is no branch: the centre of the wrist must be within reach of upper arm and forearm."""
    wrist = np.array([flange[:3, 3] - kinematics.UR5E.d[5] * flange[:3, 2] for flange in flanges])
    distance = np.linalg.norm(wrist - [0, 0, kinematics.UR5E.d[0]], axis=1)
    nearest = float(distance.min())
    if nearest > 0.5:
        return f"out of reach, wrist {nearest:.2f} m from the shoulder, limit about {kinematics.REACH:.2f} m"
    return f"too close to the base, wrist {nearest:.2f} m from the shoulder"


def _with_turns(viewpoint: Viewpoint, joints: Joints, rolls: NDArray[np.int64]) -> Solutions:
    """Each configuration near home, and with the base or the last wrist joint one turn further, within the limits."""
    joints = kinematics.nearest_turn(joints, HOME)
    shifts = [np.array([a, 0, 0, 0, 0, b]) * 2 * np.pi for a in (0, -1, 1) for b in (0, -1, 1)]
    turned = np.concatenate([joints + shift for shift in shifts])
    inside = (np.abs(turned) <= kinematics.JOINT_LIMIT - 0.05).all(axis=1)
    return Solutions(viewpoint, turned[inside], np.tile(rolls, len(shifts))[inside])


def _turned(base_from_camera: NDArray[np.float64], roll: float) -> NDArray[np.float64]:
    return base_from_camera @ pose.from_rotation_vector([0, 0, roll])
