"""The space around an object as a grid of cells, and the pixels in which each view sees them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import Scene
from koala3d.datasets.structure.bounds import PARALLEL, focus, grid
from koala3d.datasets.structure.masks.silhouette import Sight, Silhouette

CELLS = 56
"""Cells along each side of the grid."""
REACH = 1.3
"""Half the grid's side in radii of the ball that is searched."""
WITHIN = 0.6
"""Radius of the ball that stands for a cell, in half sides: with the diagonal of a pixel that is added it is about as wide."""


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
    """A cubic grid about a ball, and the views that vote on its cells."""

    ball: Ball
    sights: tuple[Sight, ...]
    """Of each view's small picture."""

    @cached_property
    def from_centre(self) -> NDArray[np.float64]:
        """(n,) distance of each cell from the ball's centre, in radii."""
        return np.linalg.norm(self._cells, axis=1)

    def drawn(self, view: int, values: NDArray[Any]) -> NDArray[np.float32]:
        """(height, width) largest of the (n,) non-negative cell values in each pixel of a view; cells fill their width."""
        sight = self.sights[view]
        picture = np.zeros((sight.camera.height, sight.camera.width), np.float32)
        for value in np.unique(values[values > 0]):
            picture[sight.covered(self._centres[values == value], self._radius)[0]] = value
        return picture

    def votes(self, view: int, mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(n,) which cells a view sees, and of which its (height, width) mask shows any part."""
        sight = self.sights[view]
        shown, empty = Silhouette(sight.camera, sight.world_from_camera, mask).votes(self._centres.T, self._radius)
        return shown, shown & ~empty

    @cached_property
    def _cells(self) -> NDArray[np.float64]:
        """(n, 3) centres about that of the ball, in radii."""
        return grid([[-REACH] * 3, [REACH] * 3], CELLS)

    @cached_property
    def _centres(self) -> NDArray[np.float64]:
        """(n, 3) centres [world unit]."""
        return self.ball.centre + self.ball.radius * self._cells

    @property
    def _radius(self) -> float:
        """Of the ball that stands for a cell [world unit]."""
        return WITHIN * REACH * self.ball.radius / CELLS


def _least_half_field(camera: Camera) -> float:
    """Tangent of the narrowest angle from the axis to the middle of a picture's edge."""
    right, bottom = camera.width - camera.cx, camera.height - camera.cy
    return min(camera.cx / camera.fx, right / camera.fx, camera.cy / camera.fy, bottom / camera.fy)
