"""Masks vote on places: each view that has a place in its picture says whether its mask leaves room for the object there.

A mask may be wrong, and so may the pose of its camera. So no view rules a place out alone: several must, and a share of those
that see it. A view has no say about places outside its picture.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.structure.bounds import half_field

FEWEST, SHARE = 2, 0.1
"""Fewest views that rule a place out, and the least share of the views that see it; both are needed. A share of 0.1 restores
the rim of a gold cape that several masks cut off (docs/lab, 2026-11-23). What it costs if masks are exact is not measured."""
Slack = tuple[float, float]
"""How far cameras may be from where they are said to be [world unit], and turned [rad]."""
EXACT: Slack = (0.0, 0.0)
GROUP, PART = 8, 32_768
"""So many views vote on so many balls one after the other, in a thread: what they work on stays in a processor's cache."""
PIXELS_APART = np.sqrt(2)
"""Two points are no nearer than the centres of their pixels less this [px]."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Where a view shows the object."""

    camera: Camera
    """Of the size of the mask."""
    world_from_camera: NDArray[np.float64]
    inside: NDArray[np.bool_]
    """(height, width) pixels of the object."""

    def votes(
        self,
        points: NDArray[np.float64],
        distance: NDArray[np.float32],
        radius: float,
        slack: Slack = EXACT,
        *,
        wholly: bool = False,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n,) flags of balls about (3, n) points: which the picture shows, and of which the mask leaves no part to the object.

        Args:
            distance: see `distance_to`.
            wholly: the picture shows a ball that lies in it altogether, not only with its centre.
        """
        focal = max(self.camera.fx, self.camera.fy)
        index, (x, y, depth), (column, row) = self._projected(points, radius)
        widening = 1 + (np.square(x / depth) + np.square(y / depth))  # of angles and lengths towards a picture's edge
        across = focal * np.sqrt(widening) / (depth - radius)
        margin = slack[0] * across + slack[1] * focal * widening if any(slack) else np.zeros(1)
        reach = radius * across + margin
        border = reach if wholly else margin
        inside = (
            (column >= border) & (row >= border) & (column < self.camera.width - border) & (row < self.camera.height - border)
        )
        if not inside.all():
            index, column, row, reach = (values[inside] for values in (index, column, row, reach))
        shown, empty = np.zeros((2, points.shape[1]), bool)
        shown[index] = True
        place = row.astype(np.intp) * distance.shape[1] + column.astype(np.intp)
        empty[index] = distance.ravel()[place] > reach + PIXELS_APART
        return shown, empty

    def unexplained(self, points: NDArray[np.float64], radius: float) -> float:
        """Share of the object's pixels, the outermost left out, that see none of the balls about (n, 3) points."""
        from scipy.ndimage import minimum_filter

        _, local, pixels = self._projected(points.T, radius)
        certain = minimum_filter(self.inside, size=3)
        if not pixels.size or not certain.any():
            return float(certain.any())
        reach = radius / (np.median(local[2]) - radius) * max(self.camera.fx, self.camera.fy) + PIXELS_APART
        pad = int(np.ceil(reach))
        covered = np.zeros((self.camera.height + 2 * pad, self.camera.width + 2 * pad), bool)
        column, row = (np.floor(pixels) + pad).astype(int)
        near = (column >= 0) & (row >= 0) & (column < covered.shape[1]) & (row < covered.shape[0])
        covered[row[near], column[near]] = True
        missed = distance_to(covered)[pad : pad + self.camera.height, pad : pad + self.camera.width] > reach
        return float(missed[certain].mean())

    def _projected(
        self, points: NDArray[np.float64], radius: float
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Points well before the camera, where its lens model is valid: indices, (3, m) in the camera's frame, (2, m) pixels."""
        local = self.world_from_camera[:3, :3].T @ (points - self.world_from_camera[:3, 3:])
        widest = np.maximum(np.abs(local[0]), np.abs(local[1]))
        ahead = (local[2] > 2 * radius) & (widest < 1.5 * half_field(self.camera) * local[2])
        index = np.flatnonzero(ahead)
        local = local if ahead.all() else np.stack([axis[ahead] for axis in local])
        return index, local, np.ascontiguousarray(self.camera.project(local.T).T)


def distance_to(inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(height, width) distance of each pixel to the nearest of those inside [px]; infinite where there is none."""
    import cv2

    if not inside.any():
        return np.full(inside.shape, np.inf, np.float32)
    found = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, np.float32)


def upheld(
    silhouettes: Sequence[Silhouette], points: NDArray[np.float64], radius: float, slack: Slack = EXACT
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Balls about (n, 3) points that the masks do not rule out: their indices, and how many views show each."""
    alive, seen, against = _counted(silhouettes, points, radius, slack, wholly=False)
    kept = against < needed(seen)
    return alive[kept], seen[kept]


def not_hopeless(
    silhouettes: Sequence[Silhouette], points: NDArray[np.float64], radius: float, slack: Slack = EXACT
) -> NDArray[np.intp]:
    """Indices of the balls in which `upheld` may find smaller ones: the others have too many votes against them."""
    return _counted(silhouettes, points, radius, slack, wholly=True)[0]


def _counted(
    silhouettes: Sequence[Silhouette], points: NDArray[np.float64], radius: float, slack: Slack, *, wholly: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Indices of balls that are not ruled out whichever other views see them, and how many see them and vote against them."""
    enough = needed(len(silhouettes))
    split = np.array_split(np.arange(len(points)), range(PART, len(points), PART))
    balls = [_Balls(index, points[index].T.copy(), *np.zeros((2, len(index)), int)) for index in split]
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for start in range(0, len(silhouettes), GROUP):
            group = silhouettes[start : start + GROUP]
            distances = list(threads.map(lambda one: distance_to(one.inside), group))

            def judged(part: _Balls, group: Any = group, distances: Any = distances) -> _Balls:
                for silhouette, distance in zip(group, distances, strict=True):
                    shown, empty = silhouette.votes(part.centres, distance, radius, slack, wholly=wholly)
                    part = part._replace(seen=part.seen + shown, against=part.against + empty)
                return part.among(part.against < enough)

            balls = list(threads.map(judged, balls))
    which, seen, against = (np.concatenate([getattr(part, name) for part in balls]) for name in ("which", "seen", "against"))
    return which, seen, against


class _Balls(NamedTuple):
    """Some balls that are not ruled out yet."""

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
        centres = np.stack([axis[chosen] for axis in self.centres])
        return _Balls(self.which[chosen], centres, self.seen[chosen], self.against[chosen])


def needed(seen: int | NDArray[np.intp]) -> NDArray[np.float64]:
    """Votes that rule a place out, of so many views that see it."""
    return np.maximum(FEWEST, np.ceil(SHARE * np.asarray(seen)))
