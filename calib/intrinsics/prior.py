"""What is known of intrinsics before a session is looked at: from another session, or from what lenses are usually like."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.intrinsics import projection


@dataclass(frozen=True)
class IntrinsicsPrior:
    """A Gaussian distribution of some intrinsics."""

    names: tuple[str, ...]
    values: Array  # (k,) in the order of `names`
    covariance: Array  # (k, k)

    def off(self, intrinsics: Array) -> Array:
        """(k,) deviations of intrinsics from what is known, whitened: independent and of unit variance."""
        return self.whitening @ (self.values - intrinsics[projection.columns(self.names)])

    def rows(self, free: Sequence[str], intrinsics: Array) -> Array:
        """(k, len(free) + 1) the same for least squares over `free` intrinsics: derivatives, and the deviations."""
        found = np.zeros((len(self.names), len(free) + 1))
        place = {name: number for number, name in enumerate(free)}
        found[:, [place[name] for name in self.names]] = self.whitening
        found[:, -1] = self.off(intrinsics)
        return found

    @cached_property
    def whitening(self) -> Array:
        """(k, k) matrix that makes deviations independent and of unit variance."""
        scale = np.sqrt(np.diag(self.covariance))  # between 1e-6 for k3 and pixels: scaled before it is inverted
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance / np.outer(scale, scale))) / scale, np.float64)
