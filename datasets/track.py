"""The path of the flange over time: poses at time stamps, and what lies between two of them.

Between two stamps the flange moves as a screw: constant speed along and about one axis (the geodesic of SE(3); Sola et al. 2018,
"A micro Lie theory", eq. 172 to 180).
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError

Array = NDArray[np.float64]
HALF_STEP_S = 0.01
"""Speeds are those over twice this time [s]: a few reports of an arm, so that their noise averages out."""
SPEEDS = "speeds"
"""Part of a scene's provenance: (6,) speed of the camera in its own axes at each view [m/s, rad/s], if the arm never halts."""
FILE, LARGEST_BYTES = "track.npz", 2**30
"""Name of the file of a recording, and its largest size."""


@dataclass(frozen=True, eq=False)
class Track:
    """Poses at ascending times."""

    times_ns: NDArray[np.int64]
    """(n,) time stamps on the clock of whoever reported the poses [ns]."""
    poses: Array
    """(n, 4, 4) base_from_flange [m]."""

    @cached_property
    def _seconds(self) -> Array:
        """(n,) times since the first pose [s]."""
        return self.seconds(self.times_ns)

    def seconds(self, times_ns: ArrayLike) -> Array:
        """Time stamps as seconds since the first pose: differences of integers keep all their digits."""
        return 1e-9 * (np.asarray(times_ns, np.int64) - self.times_ns[0]).astype(np.float64)

    def at(self, seconds: ArrayLike) -> Array:
        """(n, 4, 4) poses at (n,) times since the first [s]; those at the ends hold on outside."""
        seconds = np.asarray(seconds, np.float64)
        index, share = self._place(seconds)
        moved = logarithm(pose.inverse(self.poses[index]) @ self.poses[index + 1])
        return self.poses[index] @ exponential(share[:, None] * moved)

    def speed(self, seconds: ArrayLike) -> Array:
        """(n, 6) velocity of the flange in its own axes at (n,) times [m/s, rad/s]."""
        seconds = np.asarray(seconds, np.float64)
        before, after = self.at(seconds - HALF_STEP_S), self.at(seconds + HALF_STEP_S)
        return logarithm(pose.inverse(before) @ after) / (2 * HALF_STEP_S)

    def gap(self, seconds: ArrayLike) -> Array:
        """(n,) time between the poses around each time [s]; infinite outside the track."""
        seconds = np.asarray(seconds, np.float64)
        index, _ = self._place(seconds)
        inside = (seconds >= 0) & (seconds <= self._seconds[-1])
        return np.where(inside, self._seconds[index + 1] - self._seconds[index], np.inf)

    def _place(self, seconds: Array) -> tuple[NDArray[np.int64], Array]:
        """The pose in front of each time, and the share of the way to the next, 0 to 1."""
        known = self._seconds
        index = np.clip(np.searchsorted(known, seconds, side="right") - 1, 0, len(known) - 2)
        share = (seconds - known[index]) / (known[index + 1] - known[index])
        return index, np.clip(share, 0.0, 1.0)

    def save(self, path: Path) -> None:
        """Write atomically; rotations as they are."""
        with files.atomic_path(path) as temporary:
            np.savez_compressed(temporary, times_ns=self.times_ns, poses=self.poses)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote. Raises UsageError where it is missing, DatasetError where it is damaged."""
        content = arrays.read_npz(path, largest=LARGEST_BYTES)
        if not {"times_ns", "poses"} <= set(content):
            why = f"it holds {', '.join(content) or 'nothing'}"
            raise DatasetError("path of the flange is not complete", where=path, why=why)
        times, poses = content["times_ns"], content["poses"]
        if times.ndim != 1 or len(times) < 2 or poses.shape != (len(times), 4, 4) or not np.isfinite(poses).all():
            raise DatasetError("path of the flange is not complete", where=path, why=f"{times.shape} times, {poses.shape} poses")
        if times.dtype != np.int64 or not (np.diff(times) > 0).all():
            raise DatasetError("path of the flange is not in order of time", where=path)
        return cls(times, poses)


def exponential(twists: Array) -> Array:
    """(n, 4, 4) motions along (n, 6) twists: translation [m], then rotation vector [rad]."""
    rotation = np.asarray(Rotation.from_rotvec(twists[:, 3:]).as_matrix())
    return pose.rigid(rotation, np.einsum("nij,nj->ni", _bend(twists[:, 3:]), twists[:, :3]))


def logarithm(motions: Array) -> Array:
    """(n, 6) twists of (n, 4, 4) motions; the inverse of `exponential` for turns below pi."""
    turn = pose.rotation_vector(motions)
    return np.asarray(np.hstack([np.linalg.solve(_bend(turn), motions[:, :3, 3:])[..., 0], turn]), np.float64)


def _bend(turns: Array) -> Array:
    """(n, 3, 3) matrices that make the end of a screw's way from its speed (Sola et al. 2018, eq. 174)."""
    angle2 = np.sum(turns**2, -1)[:, None, None]
    large = angle2 > 1e-8
    safe = np.where(large, angle2, 1.0)
    angle, skew = np.sqrt(safe), pose.cross(turns)
    cosine = np.where(large, (1 - np.cos(angle)) / safe, 0.5 - angle2 / 24)
    cubic = np.where(large, (angle - np.sin(angle)) / (safe * angle), 1 / 6 - angle2 / 120)
    return np.asarray(np.eye(3) + cosine * skew + cubic * (skew @ skew), np.float64)
