"""When an arm counts as still: the spread of its joint angles over a window of time.

Positions are judged, not speeds: encoders give the speed at a single moment with noise of the size of the limit, and a joint that
swings has no speed at its turning points.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Settling:
    """The arm is still when no joint angle varied by more than `spread` [rad] in the last `time_s` [s] of the controller's clock.

    It is an error where that takes longer than `timeout_s` [s], on the host's clock.
    """

    spread: float = 5e-5
    time_s: float = 0.3
    timeout_s: float = 5.0


class Window:
    """The newest samples of the joints, as many as it takes to cover `time_s`."""

    def __init__(self, time_s: float) -> None:
        self.time_s = time_s
        self._samples: deque[tuple[float, NDArray[np.float64]]] = deque()

    def add(self, robot_time_s: float, joints: ArrayLike) -> None:
        """Take a sample: the controller's clock [s], and the angles [rad]."""
        self._samples.append((robot_time_s, np.asarray(joints, np.float64)))
        while len(self._samples) > 1 and robot_time_s - self._samples[1][0] >= self.time_s:
            self._samples.popleft()

    @property
    def full(self) -> bool:
        """Whether the samples cover `time_s`."""
        return bool(self._samples) and self._samples[-1][0] - self._samples[0][0] >= self.time_s

    @property
    def spread(self) -> float:
        """Largest minus smallest angle, of the joint that varies most [rad]."""
        return float(np.ptp([joints for _, joints in self._samples], axis=0).max())

    @property
    def mean(self) -> NDArray[np.float64]:
        """(joints,) mean angles [rad]."""
        return np.mean([joints for _, joints in self._samples], axis=0)
