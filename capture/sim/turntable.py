"""The turntable of the simulated rig: where its axis truly is, and how the object truly stands on it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.turntable import TurntableDescription
from koala3d.capture.sim.grbl import SimulatedGrbl
from koala3d.datasets import pose
from koala3d.datasets.turntable import Axis

SHIFT_M = 2e-3  # standard deviation of the axis from the nominal one, along each direction across it
TILT_RAD = np.deg2rad(0.3)  # the same of its tilt
GEAR_RAD = np.deg2rad(0.005)  # amplitude of what the gear adds to the reported angle, once and twice per turn


@dataclass(frozen=True)
class TurntableTruth:
    """The true axis and the true angle of each reported one."""

    axis: Axis
    phases: tuple[float, float]

    @classmethod
    def draw(cls, table: TurntableDescription, seed: int) -> Self:
        """The table of a seed, independent of the scene and of the rest of the rig."""
        rng = np.random.default_rng([seed, 17])
        tilt, shift = rng.normal(0, TILT_RAD, 2), rng.normal(0, SHIFT_M, 2)
        error = pose.from_rotation_vector([*tilt, 0], [*shift, 0])
        first, second = rng.uniform(0, 2 * np.pi, 2).tolist()
        return cls(Axis.of(table.base_from_turntable.matrix() @ error), (first, second))

    def angle(self, reported: float) -> float:
        """The true angle [rad]; zero where zero is reported."""
        first, second = self.phases
        worm = np.sin(reported + first) - np.sin(first) + np.sin(2 * reported + second) - np.sin(second)
        return float(reported + GEAR_RAD * worm)

    def base_from_object(self, reported: float) -> NDArray[np.float64]:
        """(4, 4) true pose of the object's frame at a reported angle [rad]."""
        return self.axis.base_from_object(self.angle(reported))


class SimulatedTurntable:
    """A simulated controller, and the object that it turns.

    Args:
        table: what the rig file says of it. Its address is left aside.
        seed: of the true axis.
        time_scale: speed of its motions relative to real time.
    """

    def __init__(self, table: TurntableDescription, seed: int, time_scale: float = 1.0) -> None:
        self.truth = TurntableTruth.draw(table, seed)
        self._table, self._time_scale = table, time_scale
        self.controller = SimulatedGrbl(time_scale=time_scale)

    def __enter__(self) -> Self:
        self.controller.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self.controller.__exit__(*exception)

    @property
    def reached(self) -> TurntableDescription:
        """What a driver needs to reach the running controller, on the simulation's clock."""
        found = {"address": self.controller.address, "settle_time_s": self._table.settle_time_s / self._time_scale}
        return self._table.model_copy(update=found)

    def base_from_object(self) -> NDArray[np.float64]:
        """(4, 4) true pose of the object's frame now."""
        sign = -1.0 if self._table.reversed else 1.0
        return self.truth.base_from_object(sign * self.controller.place * 2 * np.pi / self._table.units_per_turn)
