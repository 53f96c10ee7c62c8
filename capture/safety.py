"""Limits of the arm. A target is checked before anything moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.errors import SafetyError
from capture.kinematics import JOINT_LIMIT


@dataclass(frozen=True)
class Limits:
    """Largest joint speed [rad/s], acceleration [rad/s^2] and angle [rad]."""

    speed: float = 1.05
    acceleration: float = 1.4
    joint: float = JOINT_LIMIT

    def check(self, joints: ArrayLike, speed: float, acceleration: float) -> NDArray[np.float64]:
        """Check a motion to `joints` [rad]; returns them as a (6,) array.

        Raises SafetyError: names the limit, its value, and the requested value. Nothing has moved.
        """
        target = np.asarray(joints, np.float64)
        if target.shape != (6,) or not np.isfinite(target).all():
            raise SafetyError("target is not six finite joint angles", why=f"got {np.array2string(target, precision=3)}")
        worst = int(np.abs(target).argmax())
        if abs(target[worst]) > self.joint:
            why = f"{np.degrees(target[worst]):.0f} degrees, limit {np.degrees(self.joint):.0f}"
            raise SafetyError(f"joint {worst + 1} would leave its range", why=why, remedy="plan the view with another branch")
        asked_and_limits = {"speed": (speed, self.speed, "rad/s"), "acceleration": (acceleration, self.acceleration, "rad/s^2")}
        for name, (asked, limit, unit) in asked_and_limits.items():
            if not 0 < asked <= limit:
                why = f"{asked:g} {unit}, limit {limit:g}"
                remedy = f"lower motion.{name} in the trajectory or raise the limit in the rig file"
                raise SafetyError(f"{name} is outside the rig's limit", why=why, remedy=remedy)
        return target
