from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from koala3d.calib.errors import CalibrationError
from koala3d.calib.solver.levenberg_marquardt import Limits, minimise

LIMITS = Limits(max_steps=200, tolerance=1e-14, least_cost=1e-12)


@dataclass(frozen=True)
class Rosenbrock:
    """Residuals 10 (y - x^2) and 1 - x: a narrow bent valley with its minimum at (1, 1)."""

    place: np.ndarray
    wall: float = np.inf
    """No step beyond this x."""

    @property
    def residuals(self) -> np.ndarray:
        x, y = self.place
        return np.array([10 * (y - x**2), 1 - x])

    @property
    def cost(self) -> float:
        return float((self.residuals**2).sum())

    def stepped(self, damping: float) -> "Rosenbrock":
        jacobian = np.array([[-20 * self.place[0], 10.0], [-1.0, 0.0]])
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -jacobian.T @ self.residuals)
        if self.place[0] + step[0] > self.wall:
            raise CalibrationError("beyond the wall")
        return Rosenbrock(self.place + step, self.wall)


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.0, 0.0)])
def test_the_minimum_is_found(start: tuple[float, float]) -> None:
    found, steps = minimise(Rosenbrock(np.array(start)), LIMITS)
    np.testing.assert_allclose(found.place, 1, atol=1e-6)
    assert 0 < steps < 100


def test_the_cost_never_rises() -> None:
    costs = [minimise(Rosenbrock(np.array([-1.2, 1.0])), Limits(n, 0.0, 0.0))[0].cost for n in range(12)]
    assert all(after <= before for before, after in pairwise(costs)) and costs[-1] < 0.5 * costs[0]


def test_steps_that_fail_are_shortened() -> None:
    found, _ = minimise(Rosenbrock(np.array([-1.2, 1.0]), wall=0.5), LIMITS)
    assert 0 < found.place[0] <= 0.5, "it stops before the wall"


def test_a_start_without_any_step_comes_back() -> None:
    start = Rosenbrock(np.array([0.0, 0.0]), wall=-1.0)
    assert minimise(start, LIMITS) == (start, 0)


def test_rounding_ends_the_search() -> None:
    @dataclass(frozen=True)
    class Flat:
        tries: list[float]
        cost: float = 1.0

        def stepped(self, damping: float) -> "Flat":
            self.tries.append(damping)
            return Flat(self.tries, 1.0 + 1e-15)

    patient, hasty = Flat([]), Flat([])
    assert minimise(patient, LIMITS)[1] == minimise(hasty, Limits(200, 1e-14, 0.0, rounding=1e-12))[1] == 0
    assert len(patient.tries) > 10 and len(hasty.tries) == 1
