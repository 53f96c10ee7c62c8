"""An arm that is wherever it is told to be, for tests of what stands on the protocol rather than on a driver."""

import time
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from capture import kinematics
from capture.rig import RobotState

HOME = np.array([0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0])


class FakeRobot:
    def __init__(self) -> None:
        self.joints, self.moves, self.stopped = HOME.copy(), 0, False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stopped = True

    def move_to(self, joints: NDArray[np.float64], *, speed: float, acceleration: float) -> None:
        self.joints, self.moves = np.array(joints), self.moves + 1

    def state(self) -> RobotState:
        pose = kinematics.forward(self.joints)
        return RobotState(pose, self.joints.copy(), np.zeros(6), time.monotonic(), time.monotonic_ns())

    def stop(self) -> None:
        self.stopped = True

    def description(self) -> dict[str, Any]:
        return {"model": "fake"}
