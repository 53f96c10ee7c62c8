"""Levenberg-Marquardt (Marquardt 1963; Nocedal & Wright 2006, section 10.3): Gauss-Newton steps, damped until the cost falls."""

from dataclasses import dataclass
from typing import Protocol, Self, TypeVar

import numpy as np

from koala3d.calib.errors import CalibrationError

START = 1e-6  # damping of the first step


class Point(Protocol):
    """A state at which the cost and its linearisation are known."""

    @property
    def cost(self) -> float:
        """What is minimised."""
        ...

    def stepped(self, damping: float) -> Self:
        """The point after one damped step. Raises LinAlgError or CalibrationError where there is none."""
        ...


P = TypeVar("P", bound=Point)


@dataclass(frozen=True)
class Limits:
    """When to stop."""

    max_steps: int
    tolerance: float  # a step that lowers the cost by less than this share of it is the last one
    least_cost: float  # the tolerance of smaller costs is a share of this cost
    rounding: float = 0.0  # a step that raises the cost by less than this share of it shows rounding errors only: the search ends
    min_damping: float = 0.0
    max_damping: float = 1e10


def minimise(point: P, limits: Limits) -> tuple[P, int]:
    """The best point that was reached from `point`, and the number of accepted steps."""
    damping, steps = START, 0
    while steps < limits.max_steps and damping < limits.max_damping:
        try:
            following = point.stepped(damping)
        except (np.linalg.LinAlgError, CalibrationError):
            damping *= 10
            continue
        gained = point.cost - following.cost
        if not gained >= 0:
            if gained > -limits.rounding * point.cost:
                break
            damping *= 10
            continue
        point, damping, steps = following, max(damping / 10, limits.min_damping), steps + 1
        if gained <= limits.tolerance * max(point.cost, limits.least_cost):
            break
    return point, steps
