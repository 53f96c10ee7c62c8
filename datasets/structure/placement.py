"""How well the given poses and intrinsics place what several views see: the evidence for refining them.

Features are found to about a third of a pixel; points that miss their features by more say that cameras are not where they are
given.
"""

from dataclasses import dataclass

import numpy as np

from koala3d.datasets.structure.matching import Matches
from koala3d.datasets.structure.triangulate import Cloud, triangulate

NOISE_PX = 0.3
"""Median error of features alone, on simulated and on real scenes [px of the image that was searched]."""
DOUBTED_PX = 0.6
"""Median error from which cameras are not where they are given: twice the features' own."""
FEWEST = 300
"""Points from which anything is said."""


@dataclass(frozen=True)
class Reprojection:
    """Distances between triangulated points and the features behind them."""

    points: int
    median_px: float
    """In the images that were searched."""
    beyond_rad: float
    """Angle that is left of it once the features' own error is taken out."""
    depth: float
    """Median distance of the points from the cameras that saw them [world unit]."""

    @property
    def doubtful(self) -> bool:
        """Whether the poses can be improved."""
        return self.points >= FEWEST and self.median_px > DOUBTED_PX

    def words(self) -> str:
        """What was found, in a sentence."""
        if self.points < FEWEST:
            return "too few points were matched"
        return f"{self.points} matched points miss their features by {self.median_px:.2f} px in the median"


def reprojection_of(matches: Matches) -> Reprojection:
    """Triangulate matches with the poses of their views and look at what is left."""
    matrices = np.stack([view.world_from_camera for view in matches.views])
    cloud = triangulate(matches, matrices)
    if not len(cloud.points):
        return Reprojection(0, 0.0, 0.0, 0.0)
    median = float(np.median(cloud.errors_px))
    pixel = float(np.median([features.pixel for features in matches.features]))
    return Reprojection(len(cloud.points), median, np.sqrt(max(median**2 - NOISE_PX**2, 0.0)) * pixel, _depth(cloud, matrices))


def _depth(cloud: Cloud, matrices: np.ndarray) -> float:
    point, view = cloud.sightings.T
    return float(np.median(np.linalg.norm(cloud.points[point] - matrices[view, :3, 3], axis=-1)))
