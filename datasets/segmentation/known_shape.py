"""Masks of an object whose shape is known: its mesh as each camera sees it, with nothing before it."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.scene import View

FINER = 4
"""Points per pixel and axis at which the mesh is drawn; a pixel is the object's where half of them are."""
BITS = 4
"""Binary places of the coordinates at which OpenCV draws."""
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
"""A point and the four beside it."""
BEYOND = 1.0
"""How far outside the picture triangles may reach, in widths of the picture. Lenses are known no further."""


def silhouettes(
    views: Sequence[View], vertices: NDArray[np.float64], faces: NDArray[np.int64], *, done: Step = ignore
) -> list[NDArray[np.bool_]]:
    """For each view, (height, width) pixels that the mesh covers.

    Args:
        vertices: (n, 3) [world unit].
        faces: (m, 3) indices of vertices. Of any orientation, and the mesh may have holes.
    """
    found = []
    for view in views:
        found.append(_silhouette(view, vertices, faces))
        done()
    return found


def _silhouette(view: View, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    camera, fine = view.camera, view.camera.scaled(view.camera.width * FINER, view.camera.height * FINER)
    local = (vertices - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    before = local[:, 2] > 0
    straight = camera.undistorted().project(np.where(before[:, None], local, [0.0, 0.0, 1.0]))
    reach = BEYOND * max(camera.width, camera.height)
    near = before & (straight > -reach).all(1) & (straight < [camera.width + reach, camera.height + reach]).all(1)
    drawn = faces[near[faces].all(1)]
    corners = fine.project(np.where(near[:, None], local, [0.0, 0.0, 1.0])) - 0.5  # OpenCV has the origin in a pixel's centre
    fixed = np.rint(corners * 2**BITS).astype(np.int32)[drawn]
    picture = np.zeros((fine.height, fine.width), np.uint8)
    for triangle in fixed:
        cv2.fillConvexPoly(picture, triangle, 1, shift=BITS)
    # OpenCV also fills the points that an edge passes by, half of which are outside.
    covered = (picture + cv2.erode(picture, CROSS)) / 2
    shares = covered.reshape(camera.height, FINER, camera.width, FINER).mean((1, 3))
    return np.asarray(shares >= 0.5)
