"""What a program asks the controller: kinematics, limits and the state of the arm. Nothing moves."""

import numpy as np

from koala3d.capture.model import kinematics
from koala3d.capture.model.kinematics import Joints
from koala3d.capture.sim.controller.commands.inverse import has_inverse, inverse
from koala3d.capture.sim.controller.commands.registers import Answer, Registers

STEP_S = 0.002  # of the controller
STEADY = 1e-3  # below this speed a joint stands still [rad/s]


def _joints_allowed(at: Registers, joints: Joints) -> bool:
    low, high = at.arm.joint_limits
    return bool(((low <= joints) & (joints <= high)).all() and at.arm.reaches(joints))


def _pose_allowed(at: Registers) -> bool:
    near = at.joints
    return has_inverse(at.arm, at.pose(0), near) and _joints_allowed(at, inverse(at.arm, at.pose(0), near))


ANSWERS: dict[int, Answer] = {
    25: lambda at: 0,  # steps since a contact: there is none
    26: lambda at: np.array([STEP_S]),
    28: lambda at: at.arm.base_from_tcp(at.arm.waypoint(at.now)),
    30: lambda at: inverse(at.arm, at.pose(0), at.arguments(6, 6)),
    36: _pose_allowed,
    37: lambda at: _joints_allowed(at, at.arguments(0, 6)),
    39: lambda at: at.pose(0) @ at.pose(6),
    43: lambda at: at.arm.base_from_tcp(at.joints),
    44: lambda at: kinematics.forward(at.arguments(0, 6), at.arm.links) @ at.pose(6),
    46: lambda at: inverse(at.arm, at.pose(0), at.joints),
    47: lambda at: bool((np.abs(at.arm.actual(at.now)[1]) < STEADY).all()),
    58: lambda at: kinematics.forward(at.joints, at.arm.links),
    60: lambda at: has_inverse(at.arm, at.pose(0), at.joints),
    61: lambda at: has_inverse(at.arm, at.pose(0), at.arguments(6, 6)),
}
"""What commands ask for: a flag, a number of steps, numbers, or a (4, 4) pose."""
