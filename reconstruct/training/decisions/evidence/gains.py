"""Whether views differ in exposure or white balance, from the colours of points that several of them see."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.exposure import ExposureGains, exposure_gains
from koala3d.datasets.structure.matching import Matches

SURE = 8.0
"""A view differs where its log gain is so many standard deviations from the median view's. Views of shiny objects, whose
matches contradict each other, reach 7."""
BRIGHTER, TINTED = 1.4, 1.25
"""Least ratio of exposures, and of two colours' gains, by which a view differs. Shading alone reaches 1.23 and 1.13."""


def gains_between(matches: Matches) -> "Differences":
    """How the views of `matches` differ."""
    return Differences(exposure_gains(matches, np.stack([view.world_from_camera for view in matches.views])))


@dataclass(frozen=True, eq=False)
class Differences:
    """How views differ from the median view."""

    gains: ExposureGains

    @property
    def known(self) -> NDArray[np.bool_]:
        """(views,) whether a view was compared with others, in all colours."""
        return np.all(np.isfinite(self.gains.log_gains), axis=1)

    @property
    def brighter(self) -> NDArray[np.bool_]:
        """(views,) whether the view's exposure differs."""
        return self._differs(np.abs(self.gains.log_gains.mean(1)), BRIGHTER)

    @property
    def tinted(self) -> NDArray[np.bool_]:
        """(views,) whether the view's white balance differs."""
        return self._differs(np.ptp(self.gains.log_gains, axis=1), TINTED)

    @property
    def needed(self) -> str:
        """What has to be learned per view, as `train.per_image` names it."""
        return "colour" if self.tinted.any() else "exposure" if self.brighter.any() else "none"

    def words(self) -> str:
        """What was found, in a sentence."""
        if not self.known.any():
            return "too few points were matched"
        ratios = self.gains.gains[self.known]
        count = f"{self.brighter.sum()} of {self.known.sum()} views are brighter or darker than the median view"
        tinted = f", {self.tinted.sum()} have another white balance" if self.tinted.any() else ""
        return f"{count} ({ratios.min():.2f} to {ratios.max():.2f} times its light){tinted}"

    def log_gains_of(self, views: tuple[View, ...]) -> NDArray[np.float64]:
        """(views, 3) log gains, zero where a view was not compared."""
        measured = dict(zip(self.gains.names, np.where(self.known[:, None], self.gains.log_gains, 0.0), strict=True))
        return np.stack([measured.get(view.name, np.zeros(3)) for view in views])

    def _differs(self, size: NDArray[np.float64], ratio: float) -> NDArray[np.bool_]:
        size, sigma = (np.where(self.known, values, 0.0) for values in (size, self.gains.std.max(1)))
        return (size > np.log(ratio)) & (size > SURE * sigma)
