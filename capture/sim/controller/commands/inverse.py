"""Joint angles of the tool poses that commands give."""

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model import kinematics
from koala3d.capture.model.kinematics import Joints
from koala3d.capture.sim.controller.commands.registers import ProgramError
from koala3d.capture.sim.controller.motions.arm import SimulatedArm
from koala3d.datasets import pose


def inverse(arm: SimulatedArm, base_from_tcp: NDArray[np.float64], near: Joints) -> Joints:
    """(6,) joint angles nearest to `near` that bring the tool to a pose. Raises ProgramError: there are none."""
    base_from_flange = base_from_tcp @ pose.inverse(arm.flange_from_tcp)
    branches = arm.model.inverse(base_from_flange)
    if not len(branches):
        raise ProgramError("the inverse kinematics of a pose has no solution")
    branches = kinematics.nearest_turn(branches, near)
    joints = branches[np.abs(branches - near).max(axis=1).argmin()]
    for _ in range(5):  # the closed form has the nominal links: a few Newton steps lead to the true ones
        reached = kinematics.forward(joints, arm.links)
        turn = pose.rotation_vector(base_from_flange[:3, :3] @ reached[:3, :3].T)
        step = np.concatenate([base_from_flange[:3, 3] - reached[:3, 3], turn])
        joints = joints + np.linalg.lstsq(kinematics.jacobian(joints, arm.links), step, rcond=1e-9)[0]
    return joints


def has_inverse(arm: SimulatedArm, base_from_tcp: NDArray[np.float64], near: Joints) -> bool:
    """Whether there are such angles."""
    try:
        return len(inverse(arm, base_from_tcp, near)) > 0
    except ProgramError:
        return False
