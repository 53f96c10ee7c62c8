"""The configurations of the arm that take one view, or the reason why there is none."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model import kinematics
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.viewpoints import Viewpoint
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.datasets import pose

Joints = NDArray[np.float64]

LIMIT_MARGIN = 0.05  # solutions keep this far from the limits of the joints [rad]
MIN_SINGULARITY = 0.03  # configurations closer to a singularity are not used; see `kinematics.singularity`


@dataclass(frozen=True)
class Solutions:
    """The configurations that take one view."""

    viewpoint: Viewpoint
    joints: Joints  # (m, n) [rad]
    rolls: NDArray[np.int64]  # (m,) index of the roll of the view that each of them takes
    reason: str = ""  # why none of them can be used; empty if all can

    def within(self, mount: Carrier, roll: int) -> "Solutions":
        """Those within the limit of the cable: with this roll if there are any, else with any roll; without any, the reason."""
        permitted = mount.permitted(self.joints)
        keep = permitted & (self.rolls == roll)
        keep = keep if keep.any() else permitted
        reason = "" if keep.any() else mount.forbidden(self.joints[int(mount.wound(self.joints).argmin())])
        return Solutions(self.viewpoint, self.joints[keep], self.rolls[keep], reason)

    def taken_by(self, index: int, mount: Carrier) -> Viewpoint:
        """The view with the camera pose that one of the configurations reaches."""
        wanted = self.viewpoint
        if wanted.base_from_camera is None:
            return replace(wanted, base_from_camera=mount.base_from_camera(self.joints[index]))
        turned = _turned(wanted.base_from_camera, wanted.rolls[int(self.rolls[index])])
        return replace(wanted, base_from_camera=turned, rolls=(0.0,))


def solve(viewpoint: Viewpoint, obstacles: Obstacles) -> Solutions:
    """Every configuration that takes the view and is clear of the obstacles; without any, the reason."""
    table = obstacles.carrier.turntable
    if table is not None and viewpoint.turntable is not None and (beyond := table.outside(viewpoint.turntable)):
        return Solutions(viewpoint, np.zeros((0, obstacles.carrier.arm.count)), np.zeros(0, np.int64), beyond)
    if viewpoint.joints is not None:
        return _check_given(viewpoint, viewpoint.joints[None], obstacles)
    assert viewpoint.base_from_camera is not None  # a viewpoint has either
    carrier = obstacles.carrier
    flanges = [obstacles.flange_for(_turned(viewpoint.base_from_camera, roll)) for roll in viewpoint.rolls]
    branches = [carrier.inverse(base_from_flange) for base_from_flange in flanges]
    joints = np.concatenate(branches)
    rolls = np.repeat(np.arange(len(branches)), [len(b) for b in branches])
    if not len(joints):
        return Solutions(viewpoint, joints, rolls, _out_of_reach(flanges, carrier))
    joints = kinematics.nearest_turn(joints, carrier.arm.home, carrier.arm.lower, carrier.arm.upper)
    inside = carrier.arm.inside(joints, LIMIT_MARGIN)
    if not inside.any():
        return Solutions(viewpoint, joints, rolls, "only beyond the limits of the joints")
    joints, rolls = joints[inside], rolls[inside]
    margin = obstacles.margin(joints)
    if (margin < 0).all():
        return Solutions(viewpoint, joints, rolls, _too_close(joints[int(margin.argmax())], obstacles))
    joints, rolls = joints[margin >= 0], rolls[margin >= 0]
    sight = obstacles.sight(joints)
    if (sight < 0).all():
        hiding = obstacles.hiding(joints[int(sight.argmax())])
        return Solutions(viewpoint, joints, rolls, f"{hiding} hides the object from the camera")
    keep = (sight >= 0) & (kinematics.singularity(joints, carrier.links) >= MIN_SINGULARITY)
    if not keep.any():
        return Solutions(viewpoint, joints, rolls, "only next to a singular configuration")
    return _with_turns(viewpoint, joints[keep], rolls[keep], carrier)


def _check_given(viewpoint: Viewpoint, joints: Joints, obstacles: Obstacles) -> Solutions:
    """A view whose joint angles are given, (1, n)."""
    arm = obstacles.carrier.arm
    if joints.shape[-1] != arm.count:
        reason = f"{joints.shape[-1]} joint angles for the {arm.name}, which has {arm.count} joints"
        return Solutions(viewpoint, joints, np.zeros(1, np.int64), reason)
    reason = obstacles.carrier.forbidden(joints[0])
    if not reason and obstacles.margin(joints)[0] < 0:
        reason = _too_close(joints[0], obstacles)
    return Solutions(viewpoint, joints, np.zeros(1, np.int64), reason)


def _too_close(joints: Joints, obstacles: Obstacles) -> str:
    pair, room = obstacles.nearest(joints)
    return f"{pair} too close, {-room * 1000:.0f} mm inside the clearance"


def _out_of_reach(flanges: list[NDArray[np.float64]], carrier: Carrier) -> str:
    """Why there is no branch: the wrist must be within reach of upper arm and forearm."""
    nearest, reach = min(carrier.arm.wrist_distance(flange) for flange in flanges), carrier.arm.reach
    if nearest > 0.6 * reach:
        return f"out of reach, wrist {nearest:.2f} m from the shoulder, limit about {reach:.2f} m"
    return f"too close to the base, wrist {nearest:.2f} m from the shoulder"


def _with_turns(viewpoint: Viewpoint, joints: Joints, rolls: NDArray[np.int64], carrier: Carrier) -> Solutions:
    """Each configuration, and with the first or the last joint one turn further, within the limits of joints and cable."""
    ends = np.eye(carrier.arm.count)[[0, -1]] * 2 * np.pi
    turned = np.concatenate([joints + a * ends[0] + b * ends[1] for a in (0, -1, 1) for b in (0, -1, 1)])
    within = carrier.permitted(turned, LIMIT_MARGIN)
    reason = "" if within.any() else carrier.forbidden(joints[int(carrier.wound(joints).argmin())])
    return Solutions(viewpoint, turned[within], np.tile(rolls, 9)[within], reason)


def _turned(base_from_camera: NDArray[np.float64], roll: float) -> NDArray[np.float64]:
    return base_from_camera @ pose.from_rotation_vector([0, 0, roll])
