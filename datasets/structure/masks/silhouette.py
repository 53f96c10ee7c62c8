"""Where views show the object, at the size of small pictures; `votes` finds the space that this leaves to it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure.bounds import half_field

VIEWS, SIDE = 64, 512
"""Largest number of views whose masks are read, and longest side at which they are read [px]."""
FAINTEST = 0.1
"""Share of a pixel above which it may be of the object: compressed masks have specks of a few hundredths."""
PIXELS_APART = np.sqrt(2)
"""Two points are no nearer than the centres of their pixels less this [px]."""
Slack = tuple[float, float]
"""How far cameras may be from where they are said to be [world unit], and turned [rad]."""
EXACT: Slack = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Sight:
    """What a view would see."""

    camera: Camera
    """Of the size of the small picture."""
    world_from_camera: NDArray[np.float64]

    def projected(
        self, points: NDArray[np.float64], radius: float
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
        """Balls about (3, n) points that are well before the camera, where its lens model is valid.

        Returns:
            Their indices, their centres in the camera's frame (3, m), and the pixels (2, m).
        """
        local = self.world_from_camera[:3, :3].T @ (points - self.world_from_camera[:3, 3:])
        widest = np.maximum(np.abs(local[0]), np.abs(local[1]))
        ahead = (local[2] > 2 * radius) & (widest < 1.5 * half_field(self.camera) * local[2])
        index = np.flatnonzero(ahead)
        local = local if ahead.all() else np.stack([axis[ahead] for axis in local])
        return index, local, np.ascontiguousarray(self.camera.project(local.T).T)

    def covered(self, points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.bool_], float]:
        """(height, width) pixels that see any of the balls about (n, 3) points, and how far a ball reaches on average [px]."""
        height, width = self.camera.height, self.camera.width
        _, local, pixels = self.projected(points.T, radius)
        if not pixels.size:
            return np.zeros((height, width), bool), PIXELS_APART
        reach = float(radius / (np.median(local[2]) - radius) * max(self.camera.fx, self.camera.fy) + PIXELS_APART)
        pad = int(np.ceil(reach))
        centres = np.zeros((height + 2 * pad, width + 2 * pad), bool)
        column, row = (np.floor(pixels) + pad).astype(int)
        near = (column >= 0) & (row >= 0) & (column < centres.shape[1]) & (row < centres.shape[0])
        centres[row[near], column[near]] = True
        return distance_to(centres)[pad : pad + height, pad : pad + width] <= reach, reach


@dataclass(frozen=True, eq=False)
class Silhouette(Sight):
    """Where a view shows the object."""

    inside: NDArray[np.bool_]
    """(height, width) pixels of the object."""
    slack: Slack = EXACT

    @cached_property
    def distance(self) -> NDArray[np.float32]:
        """(height, width) distance of each pixel to the nearest of the object."""
        return distance_to(self.inside)

    def votes(
        self, points: NDArray[np.float64], radius: float, *, wholly: bool = False
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n,) flags of balls about (3, n) points: which the picture shows, and of which the mask leaves no part to the object.

        Args:
            wholly: the picture shows a ball that lies in it altogether, not only with its centre.
        """
        focal = max(self.camera.fx, self.camera.fy)
        index, (x, y, depth), (column, row) = self.projected(points, radius)
        widening = 1 + (np.square(x / depth) + np.square(y / depth))  # of angles and lengths towards a picture's edge
        across = focal * np.sqrt(widening) / (depth - radius)
        margin = self.slack[0] * across + self.slack[1] * focal * widening if any(self.slack) else np.zeros(1)
        reach = radius * across + margin
        border = reach if wholly else margin
        inside = (
            (column >= border) & (row >= border) & (column < self.camera.width - border) & (row < self.camera.height - border)
        )
        if not inside.all():
            index, column, row, reach = (values[inside] for values in (index, column, row, reach))
        shown, empty = np.zeros((2, points.shape[1]), bool)
        shown[index] = True
        place = row.astype(np.intp) * self.camera.width + column.astype(np.intp)
        empty[index] = self.distance.ravel()[place] > reach + PIXELS_APART
        return shown, empty

    def unexplained(self, points: NDArray[np.float64], radius: float) -> float:
        """Share of the object's pixels, the outermost left out, that see none of the balls about (n, 3) points."""
        from scipy.ndimage import minimum_filter

        certain = np.asarray(minimum_filter(self.inside, size=3), np.bool_)
        return float(1 - self.covered(points, radius)[0][certain].mean()) if certain.any() else 0.0


def silhouettes(views: Sequence[View]) -> list[Silhouette]:
    """Of the masks or alphas of up to `VIEWS` views, evenly spread. Raises as `View.read_cover` does."""

    def read(view: View) -> Silhouette:
        camera = view.camera.within(SIDE)
        return Silhouette(camera, view.world_from_camera, view.read_cover(camera.width, camera.height) > FAINTEST)

    return list(streamed(read, evenly(views, VIEWS), workers=READERS))


def distance_to(inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(height, width) distance of each pixel to the nearest of those inside [px]; infinite where there is none."""
    import cv2

    if not inside.any():
        return np.full(inside.shape, np.inf, np.float32)
    found = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, np.float32)
