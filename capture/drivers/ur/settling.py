"""When an arm counts as still: joint angles that vary by no more than the noise of their encoders, over a window of time.

Positions are judged, not speeds: encoders give the speed at a single moment with noise of the size of the limit, and a joint that
swings has no speed at its turning points. Nor is their largest difference judged: of white noise it grows with the noise and the
number of samples, so that a limit which suits one arm is never met by another. Variances of noise and of a motion add up, and
what the noise contributes is measured.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

DEVIATIONS = 4.0
"""How far estimates may be from what they estimate, in their own standard deviations: of six joints one in 2,600 windows is."""
FEWEST = 10  # samples from which a variance says something
NOISIEST_RAD = 5e-5
"""More noise than this is not taken for that of encoders: it moves the flange by more than the arm's repeatability [rad]."""


@dataclass(frozen=True)
class Settling:
    """The arm is still when no joint varied by more than `spread` [rad] beyond noise in the last `time_s` [s].

    The time is that of the controller's clock. It is an error where that takes longer than `timeout_s` [s], on the host's clock.
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

    def rests(self, spread: float, noise: float) -> bool:
        """Whether no joint varies by more than `spread` [rad], from peak to peak, beyond `noise` (standard deviation [rad]).

        A swing of that size has a variance of spread^2 / 8. An estimate of a variance from n samples is off by the share
        sqrt(2 / (n - 1)), and the drift of a straight line through them by noise * sqrt(12 / n) (Gaussian noise). A swing that
        decays is at the beginning of the window only: each third of it is judged as well, if it has samples enough.
        """
        count = len(self._samples)
        if not self.full:
            return False
        if count < 2:  # no time is asked for
            return True
        angles = np.array([joints for _, joints in self._samples])
        thirds = np.array_split(angles, 3) if count >= 3 * FEWEST else []
        for part in [angles, *thirds]:
            allowed = noise**2 * (1 + DEVIATIONS * np.sqrt(2 / (len(part) - 1))) + spread**2 / 8
            if part.var(axis=0, ddof=1).max() > allowed:
                return False
        return bool(np.abs(self._drift(angles)).max() <= spread + DEVIATIONS * noise * np.sqrt(12 / count))

    def _drift(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """(joints,) how far a straight line through (n, joints) angles leads within the window [rad]."""
        moments = np.array([moment for moment, _ in self._samples])
        about = moments - moments.mean()
        drift: NDArray[np.float64] = about @ angles / (about @ about) * (moments[-1] - moments[0])
        return drift

    @property
    def deviation(self) -> float:
        """Standard deviation of the angles of the joint that varies most [rad]."""
        return float(np.std([joints for _, joints in self._samples], axis=0).max())

    @property
    def mean(self) -> NDArray[np.float64]:
        """(joints,) mean angles [rad]."""
        return np.mean([joints for _, joints in self._samples], axis=0)


def noise_of(joints: Sequence[ArrayLike] | NDArray[np.float64]) -> float:
    """Standard deviation of the noise of the noisiest joint [rad], from (n, joints) samples in a row; 0 for fewer than two.

    From differences between neighbours, in which slow motions do not appear (von Neumann 1941). Two of them share a sample.
    """
    angles = np.asarray(joints, np.float64)
    if len(angles) < 2:
        return 0.0
    return float(np.sqrt((np.diff(angles, axis=0) ** 2).mean(axis=0) / 2).max())
