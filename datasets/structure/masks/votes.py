"""Masks vote on places: each view that has a place in its picture says whether its mask leaves room for the object there.

A mask may be wrong, and so may the pose of its camera. So no view rules a place out alone: several must, and a share of those
that see it. A view has no say about places outside its picture.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.structure.bounds import grid
from koala3d.datasets.structure.masks.silhouette import Silhouette

FEWEST, SHARE = 2, 0.1
"""Fewest views that rule a place out, and the least share of the views that see it; both are needed. A share of 0.1 restores
the rim of a gold cape that several masks cut off (docs/lab, 2026-11-23). What it costs if masks are exact is not measured."""
BLOCK = 4
"""Cells per side of the blocks in which space is ruled out first."""
GROUP, PART = 8, 32_768
"""So many views vote on so many balls one after the other, in a thread: what they work on stays in a processor's cache."""


def needed(seen: int | NDArray[np.intp], share: float = SHARE) -> NDArray[np.float64]:
    """Votes that rule a place out, of so many views that see it."""
    return np.maximum(FEWEST, np.ceil(share * np.asarray(seen)))


def carved(
    silhouettes: Sequence[Silhouette],
    box: ArrayLike,
    cells: int | ArrayLike,
    *,
    seen_by: int = 0,
    share: float = SHARE,
    centres: bool = False,
) -> NDArray[np.intp]:
    """The visual hull in a box: indices in `bounds.grid(box, cells)` of the cells that masks leave to the object.

    Args:
        cells: along each side, or (3,) along each axis.
        seen_by: views that must see a cell.
        share: see `needed`.
        centres: masks leave cells whose centres they show; else those of which they show any part.
    """
    counts = np.broadcast_to(np.asarray(cells), 3)
    half = float(np.linalg.norm(np.ptp(np.asarray(box, np.float64), axis=0) / counts)) / 2
    left = np.arange(counts.prod())
    if not (counts % BLOCK).any():  # most of the space is ruled out in blocks
        hopeful = np.zeros(counts // BLOCK, bool)
        hopeful.flat[_counted(silhouettes, grid(box, counts // BLOCK), BLOCK * half, share, wholly=True).which] = True
        left = np.flatnonzero(hopeful.repeat(BLOCK, 0).repeat(BLOCK, 1).repeat(BLOCK, 2))
    found = _counted(silhouettes, grid(box, counts)[left], 0.0 if centres else half, share)
    return left[found.which[(found.against < needed(found.seen, share)) & (found.seen >= seen_by)]]


class _Balls(NamedTuple):
    """Balls that are not ruled out whichever other views see them."""

    which: NDArray[np.intp]
    """(n,) indices."""
    centres: NDArray[np.float64]
    """(3, n)."""
    seen: NDArray[np.intp]
    """(n,) Views that show each."""
    against: NDArray[np.intp]
    """(n,) Views that vote against each."""

    def among(self, chosen: NDArray[np.bool_]) -> "_Balls":
        """Some of them, by (n,) flags."""
        return _Balls(self.which[chosen], self.centres[:, chosen], self.seen[chosen], self.against[chosen])


def _counted(
    silhouettes: Sequence[Silhouette],
    points: NDArray[np.float64],
    radius: float,
    share: float,
    *,
    wholly: bool = False,
) -> _Balls:
    """Votes on balls about (n, 3) points. Smaller balls in one that is shown `wholly` and ruled out are ruled out too."""
    enough = needed(len(silhouettes), share)
    split = np.array_split(np.arange(len(points)), range(PART, len(points), PART))
    balls = [_Balls(index, points[index].T.copy(), *np.zeros((2, len(index)), int)) for index in split]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(lambda one: one.distance, silhouettes))
        for start in range(0, len(silhouettes), GROUP):

            def judged(part: _Balls, group: Sequence[Silhouette] = silhouettes[start : start + GROUP]) -> _Balls:
                for silhouette in group:
                    shown, empty = silhouette.votes(part.centres, radius, wholly=wholly)
                    part = part._replace(seen=part.seen + shown, against=part.against + empty)
                return part.among(part.against < enough)

            balls = list(threads.map(judged, balls))
    return _Balls(*(np.concatenate(parts, axis=-1) for parts in zip(*balls, strict=True)))
