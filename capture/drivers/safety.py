"""Limits of the arm. A target is checked before anything moves."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.drivers.errors import SafetyError
from koala3d.capture.model.arm import ArmModel
from koala3d.capture.model.kinematics import JOINT_LIMIT


@dataclass(frozen=True)
class Limits:
    """Largest joint speed [rad/s] and acceleration [rad/s^2], and the range of each joint, (n,) [rad]."""

    speed: float = 1.05
    acceleration: float = 1.4
    lower: tuple[float, ...] = (-JOINT_LIMIT,) * 6
    upper: tuple[float, ...] = (JOINT_LIMIT,) * 6

    @classmethod
    def of(cls, arm: ArmModel, speed: float, acceleration: float) -> Self:
        """Those of an arm, at most `speed` and `acceleration`: no joint may exceed what the slowest one can do."""
        slowest, weakest = float(arm.speed.min()), float(arm.acceleration.min())
        return cls(min(speed, slowest), min(acceleration, weakest), tuple(arm.lower.tolist()), tuple(arm.upper.tolist()))

    def check(self, joints: ArrayLike, speed: float, acceleration: float) -> NDArray[np.float64]:
        """Check a motion to `joints` [rad]; returns them as a (n,) array.

        Raises SafetyError: names the limit, its value, and the requested value. Nothing has moved.
        """
        target = np.asarray(joints, np.float64)
        lower, upper = np.array(self.lower), np.array(self.upper)
        if target.shape != lower.shape or not np.isfinite(target).all():
            what = f"target is not {len(lower)} finite joint angles"
            raise SafetyError(what, why=f"got {np.array2string(target, precision=3)}")
        worst = int(np.maximum(target - upper, lower - target).argmax())
        if not lower[worst] <= target[worst] <= upper[worst]:
            limit = upper[worst] if target[worst] > upper[worst] else lower[worst]
            why = f"{np.degrees(target[worst]):.0f} degrees, limit {np.degrees(limit):.0f}"
            raise SafetyError(f"joint {worst + 1} would leave its range", why=why, remedy="plan the view with another branch")
        asked_and_limits = {"speed": (speed, self.speed, "rad/s"), "acceleration": (acceleration, self.acceleration, "rad/s^2")}
        for name, (asked, limit, unit) in asked_and_limits.items():
            if not 0 < asked <= limit:
                why = f"{asked:g} {unit}, limit {limit:g}"
                remedy = f"lower motion.{name} in the trajectory or raise the limit in the rig file"
                raise SafetyError(f"{name} is outside the rig's limit", why=why, remedy=remedy)
        return target
