"""The space around an object as a grid of cells, and the pixels in which each view sees them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure.bounds import PARALLEL, focus, grid

CELLS = 56
"""Cells along each side of the grid."""
REACH = 1.3
"""Half the grid's side in radii of the ball that is searched."""
NEAREST = 0.1
"""Depth in radii below which a view does not count as seeing a cell."""


@dataclass(frozen=True)
class Ball:
    """Where the object is looked for."""

    centre: NDArray[np.float64]
    """(3,) [world unit]."""
    radius: float
    """[world unit]."""

    @classmethod
    def of(cls, scene: Scene) -> Self | None:
        """About the point that all cameras look at, as far as pictures reach there, or about a stated box if it is smaller.

        None where neither is known: the optical axes are parallel.
        """
        poses = np.stack([view.world_from_camera for view in scene.views])
        centre, spread = focus(poses)
        distances = np.linalg.norm(poses[:, :3, 3] - centre, axis=1)
        reach = float(np.median(distances * [_least_half_field(view.camera) for view in scene.views]))
        found = cls(centre, reach) if spread >= PARALLEL else None
        if scene.box_is_stated:
            stated = cls(scene.box.mean(0), float(np.linalg.norm(np.ptp(scene.box, axis=0))) / 2)
            found = stated if found is None or stated.radius < found.radius else found
        return found


@dataclass(frozen=True, eq=False)
class Space:
    """A cubic grid about a ball, and where small pictures show its cells."""

    from_centre: NDArray[np.float64]
    """(n,) distance of each cell from the ball's centre, in radii."""
    pixels: tuple[NDArray[np.int32], ...]
    """For each view, (n,) index of the pixel that shows each cell's centre, -1 where none does."""
    sizes: tuple[tuple[int, int], ...]
    """(height, width) of each view's small picture."""
    widths: tuple[int, ...]
    """Width of a cell in each view, an odd number of pixels."""

    @classmethod
    def about(cls, ball: Ball, views: Sequence[View], cameras: Sequence[Camera]) -> Self:
        """The grid of a ball; `cameras` are those of the views' small pictures."""
        points = grid([[-REACH] * 3, [REACH] * 3], CELLS)
        found = [_seen(ball, points, view, camera) for view, camera in zip(views, cameras, strict=True)]
        sizes = tuple((camera.height, camera.width) for camera in cameras)
        return cls(np.linalg.norm(points, axis=1), tuple(one for one, _ in found), sizes, tuple(width for _, width in found))

    def drawn(self, view: int, values: ArrayLike) -> NDArray[np.float32]:
        """(height, width) largest of the (n,) non-negative cell values in each pixel of a view; cells fill their width."""
        height, width = self.sizes[view]
        picture = np.zeros(height * width, np.float32)
        seen = self.pixels[view] >= 0
        np.maximum.at(picture, self.pixels[view][seen], np.asarray(values, np.float32)[seen])
        return self._widened(view, picture.reshape(height, width))

    def votes(self, view: int, mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n,) which cells a view sees, and of which its (height, width) mask shows any part."""
        seen = self.pixels[view] >= 0
        shown = self._widened(view, mask.astype(np.float32)).ravel()[self.pixels[view]] > 0
        return seen, seen & shown

    def _widened(self, view: int, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        width = self.widths[view]
        return np.asarray(cv2.dilate(picture, np.ones((width, width), np.uint8)))


def _seen(ball: Ball, points: NDArray[np.float64], view: View, camera: Camera) -> tuple[NDArray[np.int32], int]:
    """(n,) pixel index of each point of the unit ball, -1 outside the picture, and the width of a cell [px]."""
    local = (ball.centre + ball.radius * points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    before = local[:, 2] > NEAREST * ball.radius
    at = np.floor(camera.undistorted().project(np.where(before[:, None], local, [0.0, 0.0, 1.0])))
    inside = before & ((at >= 0) & (at < [camera.width, camera.height])).all(1)
    index = np.where(inside, at[:, 1] * camera.width + at[:, 0], -1).astype(np.int32)
    depth = float(np.median(local[inside, 2])) if inside.any() else ball.radius
    width = int(np.ceil(2 * REACH * ball.radius / CELLS * camera.fx / depth))
    return index, max(width, 1) | 1


def _least_half_field(camera: Camera) -> float:
    """Tangent of the narrowest angle from the axis to the middle of a picture's edge."""
    right, bottom = camera.width - camera.cx, camera.height - camera.cy
    return min(camera.cx / camera.fx, right / camera.fx, camera.cy / camera.fy, bottom / camera.fy)
