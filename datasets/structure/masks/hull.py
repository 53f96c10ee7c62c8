"""The visual hull: the space that the masks leave to the object. Its box is a safe bound of the object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.scene import View
from koala3d.datasets.structure.bounds import Box, depth_range, grid
from koala3d.datasets.structure.masks.silhouette import Silhouette
from koala3d.datasets.structure.masks.votes import FEWEST, carved

CELLS = 48
"""Cells along each side of a box."""
GROWTH = (1.0, 1.25, 1.5, 2.0, 2.5)
"""Sizes of the box that the hull is looked for in, until it explains the masks: an object may go on beyond most pictures."""
SEEN_BY = (3, 6, 12)
"""A cell is seen by one of so many views; fewer where the hull explains the masks only then."""
UNEXPLAINED = 0.003
"""Share of the object's pixels that may see no cell of the hull, in the mean over the views."""


@dataclass(frozen=True, eq=False)
class Hull:
    """The space that an object can occupy."""

    box: Box
    """(2, 3) corners."""
    centres: NDArray[np.float64]
    """(n, 3) centres of its cells."""
    radius: float
    """Half the diagonal of a cell [world unit]."""
    views_used: int
    """Number of views whose masks were read; 0 where they exclude everything and the hull is the initial box."""

    def depth_range(self, views: Sequence[View]) -> tuple[float, float]:
        """Least and greatest depth of the hull over all cameras; near stays above a hundredth of far."""
        least, greatest = depth_range(views, self.box)
        if not self.views_used:
            return least, greatest
        nearest, furthest = np.inf, 1e-6
        for view in views:
            depths = (self.centres - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, 2]
            nearest, furthest = min(nearest, float(depths.min())), max(furthest, float(depths.max()))
        return max(nearest - self.radius, least), min(furthest + self.radius, greatest)

    def unexplained(self, silhouettes: Sequence[Silhouette]) -> float:
        """Share of the object's pixels that see none of its cells, in the mean over views."""
        return float(np.mean([silhouette.unexplained(self.centres, self.radius) for silhouette in silhouettes]))


def visual_hull(silhouettes: Sequence[Silhouette], box: ArrayLike) -> Hull:
    """The space that masks leave to the object and that a third of the views see, looked for in `box`.

    Where such a hull does not explain the masks, since the object leaves pictures at their edges, it is looked for in a larger
    box, and among what fewer views see.
    """
    start = np.asarray(box, np.float64)
    found: list[tuple[float, Hull]] = []
    for one_of in SEEN_BY:
        for growth in GROWTH:
            grown = start.mean(0) + growth * (start - start.mean(0))
            hull = _hull_within(silhouettes, grown, max(len(silhouettes) // one_of, FEWEST))
            if hull is None:
                continue
            found.append((hull.unexplained(silhouettes), hull))
            if found[-1][0] <= UNEXPLAINED:
                return hull
    return min(found, key=lambda one: one[0])[1] if found else Hull(start, np.zeros((0, 3)), 0.0, 0)


def _hull_within(silhouettes: Sequence[Silhouette], box: Box, seen_by: int) -> Hull | None:
    """The hull of what so many views see of a box; None where there is none. Three passes, each in the box of the last."""
    kept, radius, result = np.zeros((0, 3)), 0.0, box
    for _ in range(3):
        cell = (result[1] - result[0]) / CELLS
        radius = float(np.linalg.norm(cell)) / 2
        kept = grid(result, CELLS)[carved(silhouettes, result, CELLS, seen_by=seen_by)]
        if not len(kept):
            return None
        result = np.stack([np.maximum(kept.min(0) - cell, result[0]), np.minimum(kept.max(0) + cell, result[1])])
    return Hull(result, kept, radius, len(silhouettes))
