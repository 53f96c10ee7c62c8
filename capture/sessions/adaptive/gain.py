"""What one more view adds: surface that few views have seen, and new directions onto surface whose colour changes with them.

A place is covered once `ENOUGH` views see it at 60° or less. A view that sees a place for the first time adds more than one that
sees it for the second or third time, since what no picture shows cannot be reconstructed at all.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sessions.adaptive.places import Places
from koala3d.capture.sessions.adaptive.sight import GOOD

Array = NDArray[np.float64]
Facing = NDArray[np.float32]

ENOUGH = 3
WORTH = np.array([3, 2, 1, 0]) / 6
"""What the first, second and third view of a place are worth; together all of it."""
KNOWN, NEW = np.cos(np.radians([8.0, 20.0]))
"""A direction nearer than 8° to one from which a place was seen adds nothing; one further than 20° from all of them is new."""


@dataclass(frozen=True, eq=False)
class Seen:
    """How views see the places."""

    facing: Facing
    """(views, n), see `sight.facing`."""
    eyes: Array
    """(views, 3) where the cameras are [m]."""

    @cached_property
    def well(self) -> NDArray[np.bool_]:
        """(views, n) which views see which places at 60° or less."""
        return self.facing >= GOOD

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """(n,) number of views that see each place well."""
        return self.well.sum(0)


@dataclass(frozen=True)
class Coverage:
    """Shares of a surface, from 0 to 1."""

    covered: float
    """Seen well by three views, of what views within reach can cover."""
    reachable: float
    """What views within reach can cover, of all."""


def coverage(places: Places, taken: Seen, within_reach: Seen) -> Coverage:
    """How far the views that are taken cover what these and those within reach can cover."""
    possible = (taken.counts >= ENOUGH) | (within_reach.counts >= ENOUGH)
    reachable = float(places.shares[possible].sum())
    covered = float(places.shares[possible & (taken.counts >= ENOUGH)].sum())
    return Coverage(covered / reachable if reachable else 1.0, reachable)


def surface_gains(places: Places, taken: Seen, within_reach: Seen) -> Array:
    """(candidates,) what each view within reach adds by seeing places well that fewer than `ENOUGH` views have seen [share]."""
    return within_reach.well @ (places.shares * WORTH[np.minimum(taken.counts, ENOUGH)])


def angle_gains(places: Places, changing: Array, taken: Seen, within_reach: Seen, nearest: NDArray[np.float32]) -> Array:
    """(candidates,) what each view within reach adds by new directions onto places whose colour changes [share].

    Args:
        changing: (n,) from 0, the same colour from everywhere, to 1.
        nearest: (candidates, n) see `nearest_directions`.
    """
    new = np.clip((KNOWN - nearest) / (KNOWN - NEW), 0, 1)
    return np.where(within_reach.well, new, 0) @ np.where(taken.counts > 0, places.shares * changing, 0)


def nearest_directions(taken: Facing, well: NDArray[np.bool_], within_reach: Facing) -> Facing:
    """(candidates, n) how near the direction from each place to a view within reach is to one from which it was seen well.

    The cosine of the smallest angle between them; -1 where no view has seen the place.

    Args:
        taken, within_reach: (views, n, 3) and (candidates, n, 3), see `directions`.
        well: (views, n) see `Seen.well`.
    """
    nearest = np.full(within_reach.shape[:2], -1.0, np.float32)
    for way, seen in zip(taken, well, strict=True):
        np.maximum(nearest, np.where(seen, np.einsum("cnd,nd->cn", within_reach, way), np.float32(-1.0)), out=nearest)
    return nearest


def directions(points: Array, eyes: Array) -> Facing:
    """(views, n, 3) unit vectors from places to cameras."""
    ways = (eyes[:, None] - points[None]).astype(np.float32)
    return np.asarray(ways / np.linalg.norm(ways, axis=-1, keepdims=True), np.float32)
