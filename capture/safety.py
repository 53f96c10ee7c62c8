"""What may be asked of the arm. A target is judged before anything moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.errors import SafetyError
from capture.kinematics import JOINT_LIMIT


@dataclass(frozen=True)
class Limits:
    """Fastest joint speed [rad/s] and acceleration [rad/s^2], and how far each joint may turn [rad]."""

    speed: float = 1.05
    acceleration: float = 1.4
    joint: float = JOINT_LIMIT

    def check(self, joints: ArrayLike, speed: float, acceleration: float) -> NDArray[np.float64]:
        """`joints` as a (6,) array of finite angles [rad], after judging the motion to it.

        Raises:
            SafetyError: names the limit, its value, and what was asked for. Nothing has moved.
        """
        target = np.asarray(joints, np.float64)
        if target.shape != (6,) or not np.isfinite(target).all():
            raise SafetyError("target is not six finite joint angles", why=f"got {np.array2string(target, precision=3)}")
        worst = int(np.abs(target).argmax())
        if abs(target[worst]) > self.joint:
            raise SafetyError(
                f"joint {worst + 1} would leave its range", why=f"{np.degrees(target[worst]):.0f} degrees, limit {np.degrees(self.joint):.0f}",
                remedy="plan the view with another branch",
            )  # fmt: skip
        for name, asked, limit, unit in (
            ("speed", speed, self.speed, "rad/s"),
            ("acceleration", acceleration, self.acceleration, "rad/s^2"),
        ):
            if not 0 < asked <= limit:
                raise SafetyError(f"{name} is outside the rig's limit", why=f"{asked:g} {unit}, limit {limit:g}",
                                  remedy=f"lower motion.{name} in the trajectory or raise the limit in the rig file")  # fmt: skip
        return target
