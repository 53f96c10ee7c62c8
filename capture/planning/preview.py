"""A page for sessions that choose their views: where the camera may be, what stands around, and what the arm may sweep."""

from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from koala3d.capture.planning import draw
from koala3d.capture.planning.obstacles import Obstacles

Array = NDArray[np.float64]

CELL_M = 0.05  # edge of the cells in which the region is found
MOVES, STEPS = 150, 12
"""Straight moves between two of the views that are followed, and configurations on each of them."""
SPACING_M = 0.025  # of points along a part
MOST = 300  # views that are shown
SIZE = (120, 120, 120)
"""Cells of the grid, whose middle is the base: no arm here reaches 3 m."""


def swept_cells(start: Array, joints: Array, obstacles: Obstacles) -> Array:
    """(m, 3) middles of the outer cells of the region [m] that the body passes on the way from `start` and between views.

    The moves are straight ones between drawn pairs of (n, joints) configurations, and from (joints,) `start` to some of them. A
    detour around an obstacle may leave the region.
    """
    rng = np.random.default_rng(0)
    one, other = rng.integers(len(joints), size=(2, MOVES))
    begins = np.concatenate([joints[one], np.broadcast_to(start, (MOVES // 5, len(start)))])
    ends = np.concatenate([joints[other], joints[one[: MOVES // 5]]])
    way = np.linspace(begins, ends, STEPS).reshape(-1, len(start))
    segments = obstacles.carrier.segments(way)
    found = np.zeros(SIZE, bool)
    for part, radius in enumerate(obstacles.shape.radii):
        first, last = segments[:, part, 0], segments[:, part, 1]
        length = float(np.linalg.norm(last - first, axis=-1).max())
        share = np.linspace(0.0, 1.0, int(np.ceil(length / SPACING_M)) + 1)[:, None, None]
        points = ((1 - share) * first + share * last).reshape(-1, 3)
        for side in radius / np.sqrt(3) * np.array(list(product((-1.0, 0.0, 1.0), repeat=3))):
            cells = np.floor((points + side) / CELL_M).astype(np.int64) + np.array(SIZE) // 2
            found[tuple(np.clip(cells, 0, np.array(SIZE) - 1).T)] = True
    inner = ndimage.binary_erosion(found)
    return (np.argwhere(found & ~inner) - np.array(SIZE) // 2 + 0.5) * CELL_M


def write(start: Array, joints: Array, obstacles: Obstacles, path: Path, *, title: str) -> None:
    """Write one HTML file that loads nothing.

    Args:
        start: (n,) present joint angles [rad].
        joints: (m, n) one configuration for each view that may be chosen, m > 0.
    """
    shown = joints[:: max(int(np.ceil(len(joints) / MOST)), 1)]
    poses = obstacles.carrier.base_from_carried(shown)
    stops = np.concatenate([start[None], shown])
    names = ["where the arm stands", *(f"{index}" for index in range(len(shown)))]
    edges = [[], *(draw.pyramid(place).round(4).tolist() for place in poses)]
    each = zip(names, stops, obstacles.carrier.segments(stops), obstacles.margin(stops), edges, strict=True)
    views = [{**draw.still(name, at, arm, room), "edges": frustum} for name, at, arm, room, frustum in each]
    swept = swept_cells(start, joints, obstacles).round(3).tolist()
    words = f"{title}\ndots: where the arm may pass on straight moves between these views"
    draw.write_page(path, {**draw.surroundings(obstacles, words), "views": views, "swept": swept})
