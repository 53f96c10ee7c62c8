"""Masks vote on places: each view that has a place in its picture says whether its mask leaves room for the object there.

A mask may be wrong, and so may the pose of its camera. So no view rules a place out alone: several must, and a share of those
that see it. A view has no say about places outside its picture.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.camera_model import Camera
from datasets.structure.bounds import half_field

FEWEST, SHARE = 2, 0.1
"""A place is ruled out by so many of the views that see it, and by this share of them. A share of 0.1 restores the rims of a
set in which a tenth of the masks cut them off, and costs nothing where masks are exact; docs/lab has the figures."""
Slack = tuple[float, float]
"""How far cameras may be from where they are said to be [world unit], and turned [rad]."""
EXACT: Slack = (0.0, 0.0)
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
        self, points: NDArray[np.float64], radius: float, slack: Slack = EXACT, *, wholly: bool = False
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n,) flags of balls about (n, 3) points: which the picture shows, and of which the mask leaves no part to the object.

        Args:
            wholly: the picture shows a ball that lies in it altogether, not only with its centre.
        """
        index, local, pixels = self._projected(points, radius)
        widening = 1 + np.square(local[:, :2] / local[:, 2:]).sum(1)  # of angles and lengths towards a picture's edge
        across = max(self.camera.fx, self.camera.fy) * np.sqrt(widening) / (local[:, 2] - radius)
        margin = slack[0] * across + slack[1] * max(self.camera.fx, self.camera.fy) * widening
        reach = radius * across + margin
        border = (reach if wholly else margin)[:, None]
        inside = ((pixels >= border) & (pixels < [self.camera.width, self.camera.height] - border)).all(1)
        index, pixels, reach = index[inside], pixels[inside], reach[inside]
        shown, empty = np.zeros((2, len(points)), bool)
        column, row = pixels.astype(int).T
        shown[index] = True
        empty[index] = distance_to(self.inside)[row, column] > reach + PIXELS_APART
        return shown, empty

    def unexplained(self, points: NDArray[np.float64], radius: float) -> float:
        """Share of the object's pixels, the outermost left out, that see none of the balls about (n, 3) points."""
        from scipy.ndimage import minimum_filter

        _, local, pixels = self._projected(points, radius)
        certain = minimum_filter(self.inside, size=3)
        if not len(pixels) or not certain.any():
            return float(certain.any())
        reach = radius / (np.median(local[:, 2]) - radius) * max(self.camera.fx, self.camera.fy) + PIXELS_APART
        pad = int(np.ceil(reach))
        covered = np.zeros((self.camera.height + 2 * pad, self.camera.width + 2 * pad), bool)
        column, row = (np.floor(pixels) + pad).astype(int).T
        near = (column >= 0) & (row >= 0) & (column < covered.shape[1]) & (row < covered.shape[0])
        covered[row[near], column[near]] = True
        missed = distance_to(covered)[pad : pad + self.camera.height, pad : pad + self.camera.width] > reach
        return float(missed[certain].mean())

    def _projected(
        self, points: NDArray[np.float64], radius: float
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Points well before the camera, where its lens model is valid: indices, places in the camera's frame, pixels."""
        local = (points - self.world_from_camera[:3, 3]) @ self.world_from_camera[:3, :3]
        depth = local[:, 2]
        index = np.flatnonzero((depth > 2 * radius) & (np.abs(local[:, :2]).max(1) < 1.5 * half_field(self.camera) * depth))
        return index, local[index], self.camera.project(local[index])


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
    alive = np.arange(len(points))
    seen, against = np.zeros((2, len(points)), int)
    for silhouette in silhouettes:
        shown, empty = silhouette.votes(points[alive], radius, slack, wholly=wholly)
        seen[alive] += shown
        against[alive] += empty
        alive = alive[against[alive] < needed(len(silhouettes))]
    return alive, seen[alive], against[alive]


def needed(seen: int | NDArray[np.intp]) -> NDArray[np.float64]:
    """Votes that rule a place out, of so many views that see it."""
    return np.maximum(FEWEST, np.ceil(SHARE * np.asarray(seen)))
