"""The object's body: what is left of its box where pictures do not see the table through it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sessions.adaptive.background import Outline
from koala3d.capture.sessions.adaptive.places import Places, of_cells
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks.silhouette import Silhouette

Array = NDArray[np.float64]

CELLS = 48
"""Cells along the longest edge of the box."""
AGAINST = 0.05
"""A cell is free where this share of the views, and one at least, see the table through it, of those that could."""
JUDGED = 0.2
"""Nothing is known of a cell through which a smaller share of the views could see the table: it does not count as the object."""
STANDS = 2.0
"""A body stands on the table where the middle of a cell is so near to it [cells]."""


def carved(outlines: Sequence[Outline], corners: Array, table_z: float) -> Places | None:
    """The surface of the object's body in the box between (2, 3) corners [m]; None where nothing is left.

    Args:
        table_z: the top of the table [m].
    """
    low, high = corners
    counts = np.ceil(CELLS * (high - low) / (high - low).max()).astype(int)
    cell = (high - low) / counts
    points = bounds.grid(corners, counts).T
    against, able = np.zeros((2, points.shape[1]), int)
    for outline in outlines:
        against += _outside(outline.foreground, points)
        able += _outside(outline.silent, points)
    left = (against < np.maximum(1, np.ceil(AGAINST * able))) & (able >= JUDGED * len(outlines))
    body = _body(left.reshape(counts), np.abs(points[2, : counts[2]] - table_z) < STANDS * cell[2])
    return None if body is None else of_cells(body, low, cell)


def _outside(silhouette: Silhouette, points: Array) -> NDArray[np.bool_]:
    """(n,) which of (3, n) points are in the picture, and outside its silhouette."""
    return silhouette.votes(points, 0.0)[1]


def _body(left: NDArray[np.bool_], low: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """The largest connected body of (nx, ny, nz) cells, of those that reach the (nz,) `low` layers; of all where none does."""
    from scipy.ndimage import label

    bodies = np.asarray(label(left)[0])  # type: ignore[index]
    if not bodies.any():
        return None
    sizes, standing = np.bincount(bodies.ravel()), np.unique(bodies[..., low])
    candidates = standing[standing > 0] if standing.any() else np.arange(1, len(sizes))
    return np.asarray(bodies == candidates[sizes[candidates].argmax()])
