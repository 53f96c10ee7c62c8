"""The visual hull: the space that the masks leave to the object. Its box is a safe bound of the object."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure.bounds import Box, depth_range, grid
from koala3d.datasets.structure.votes import FEWEST, Silhouette, upheld

GROWTH = (1.0, 1.25, 1.5, 2.0, 2.5)
"""Sizes of the box that the hull is looked for in, until it explains the masks: an object may go on beyond most pictures."""
SEEN_BY = (3, 6, 12)
"""A voxel is seen by one of so many views; fewer where the hull explains the masks only then."""
UNEXPLAINED = 0.003
"""Share of the object's pixels that may see no voxel of the hull, in the mean over the views."""


@dataclass(frozen=True, eq=False)
class Hull:
    """The space that an object can occupy."""

    box: Box
    """(2, 3) corners."""
    centres: NDArray[np.float64]
    """(n, 3) centres of its voxels."""
    radius: float
    """Half the diagonal of a voxel [world unit]."""
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
        """Share of the object's pixels that see none of its voxels, in the mean over views."""
        return float(np.mean([silhouette.unexplained(self.centres, self.radius) for silhouette in silhouettes]))


def visual_hull(views: Sequence[View], box: ArrayLike, *, views_used: int = 64, resolution: int = 48) -> Hull:
    """The space that masks leave to the object and that a third of the views see, looked for in `box`.

    Where such a hull does not explain the masks, since the object leaves pictures at their edges, it is looked for in a larger
    box, and among what fewer views see.
    """
    chosen = evenly(views, views_used)
    silhouettes = list(streamed(_silhouette, chosen, workers=READERS))
    start = np.asarray(box, np.float64)
    found: list[tuple[float, Hull]] = []
    for one_of in SEEN_BY:
        for growth in GROWTH:
            grown = start.mean(0) + growth * (start - start.mean(0))
            hull = _hull_within(silhouettes, grown, max(len(chosen) // one_of, FEWEST), resolution)
            if hull is None:
                continue
            found.append((hull.unexplained(silhouettes), hull))
            if found[-1][0] <= UNEXPLAINED:
                return hull
    return min(found, key=lambda one: one[0])[1] if found else Hull(start, np.zeros((0, 3)), 0.0, 0)


def _hull_within(silhouettes: Sequence[Silhouette], box: Box, needed: int, resolution: int) -> Hull | None:
    """The hull of what `needed` views see of a box; None where there is none. Three passes, each in the box of the last."""
    kept, radius, result = np.zeros((0, 3)), 0.0, box
    for _ in range(3):
        voxel = (result[1] - result[0]) / resolution
        points = grid(result, resolution)
        radius = float(np.linalg.norm(voxel)) / 2
        index, seen = upheld(silhouettes, points, radius)
        kept = points[index[seen >= needed]]
        if not len(kept):
            return None
        result = np.stack([np.maximum(kept.min(0) - voxel, result[0]), np.minimum(kept.max(0) + voxel, result[1])])
    return Hull(result, kept, radius, len(silhouettes))


_CELL = 2
"""Pixels per side of a mask cell."""
FAINTEST = 0.1
"""Alpha above which a pixel may be of the object: compressed masks have specks of a few hundredths."""


def _silhouette(view: View) -> Silhouette:
    """A view's mask in cells, of the object where any of their pixels is."""
    stored = view.read_stored_mask() if view.mask else images.read_stored(view.image)[..., -1:]
    inside = images.as_float(stored)[..., 0] > FAINTEST
    height, width = inside.shape
    padded = np.pad(inside, ((0, -height % _CELL), (0, -width % _CELL)))
    rows, columns = padded.shape[0] // _CELL, padded.shape[1] // _CELL
    cells = np.any(padded.reshape(rows, _CELL, columns, _CELL), axis=(1, 3))
    camera = replace(view.camera, width=columns * _CELL, height=rows * _CELL).scaled(columns, rows)
    return Silhouette(camera, view.world_from_camera, cells)
