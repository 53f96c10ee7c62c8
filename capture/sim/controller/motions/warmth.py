"""How a simulated arm warms up: its joints approach a higher temperature, and its flange moves with them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

COLD, WARMING = 25.0, 15.0
"""Temperature of the joints at first, and by how much they become warmer [degrees Celsius]."""


@dataclass(frozen=True)
class Warmth:
    """An arm that is switched on at `begun_s` on the controller's clock."""

    drift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # by how much the flange moves in the end, in the base [m]
    minutes: float = 20.0  # within which it covers 63 % of that, on the controller's clock
    begun_s: float = 0.0

    @classmethod
    def drawn(cls, seed: int, drift_m: float, minutes: float, begun_s: float) -> "Warmth":
        """An arm that moves by so much in a direction of its own."""
        towards = np.random.default_rng([seed, 31]).normal(size=3)
        x, y, z = (drift_m * towards / np.linalg.norm(towards)).tolist()
        return cls((x, y, z), minutes, begun_s)

    def share(self, now: float) -> float:
        """How much of it is over, 0 to 1."""
        return float(-np.expm1(-max(now - self.begun_s, 0.0) / (60 * self.minutes)))

    def shift(self, now: float) -> NDArray[np.float64]:
        """(3,) by how much the flange has moved in the base [m]."""
        return np.asarray(self.drift, np.float64) * self.share(now)

    def temperature(self, now: float) -> float:
        """That of the joints [degrees Celsius]."""
        return COLD + WARMING * self.share(now)
