"""Which places a camera sees: those that face it, lie in its picture, and are hidden by no other place."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sessions.adaptive.places import Places
from koala3d.datasets.camera_model import Camera

Array = NDArray[np.float64]
Eye = Callable[[Array, Array], Array]
"""From (4, 4) base_from_flange [m] and (n,) joint angles [rad] to (4, 4) base_from_camera [m]."""

GOOD = float(np.cos(np.radians(60)))
"""Cosine of the largest angle between a surface and the direction to a camera that sees it well."""
PITCH = 1.5
"""Size of a cell of the depth map, in distances between neighbouring places: nearly every cell in front of a surface has one."""


def facing(places: Places, base_from_camera: Array, camera: Camera | None = None) -> NDArray[np.float32]:
    """(n,) cosine of the angle between each place's normal and the direction to the camera; 0 where the camera does not see it.

    Args:
        base_from_camera: (4, 4) [m].
        camera: with the size of the pictures; None: the pictures show all places.
    """
    towards = base_from_camera[:3, 3] - places.points
    distance = np.linalg.norm(towards, axis=1)
    cosine = (towards * places.normals).sum(1) / np.maximum(distance, 1e-9)
    local = (places.points - base_from_camera[:3, 3]) @ base_from_camera[:3, :3]
    seen = (cosine > 0) & (local[:, 2] > 1e-3)
    if camera is not None:
        seen[seen] &= _in_picture(local[seen], camera)
    seen[seen] &= ~_hidden(places, local, cosine)[seen]
    return np.where(seen, cosine, 0.0).astype(np.float32)


def whichever_way_up(camera: Camera) -> Camera:
    """The middle square of a camera's pictures: what it shows of an object whichever quarter turn the planner chooses."""
    side = min(camera.width, camera.height)
    cx, cy = camera.cx - (camera.width - side) / 2, camera.cy - (camera.height - side) / 2
    return replace(camera, width=side, height=side, cx=cx, cy=cy)


def _in_picture(local: Array, camera: Camera) -> NDArray[np.bool_]:
    column, row = camera.project(local).T
    return (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)


def _hidden(places: Places, local: Array, cosine: Array) -> NDArray[np.bool_]:
    """(n,) which places lie behind others in a depth map of all places, by more than their own slope explains."""
    depth = np.maximum(local[:, 2], 1e-3)
    pitch = PITCH * places.spacing / float(np.median(depth))
    column, row = np.floor(local[:, :2] / depth[:, None] / pitch).astype(np.int64).T
    column, row = column - column.min(), row - row.min()
    cell = row * (int(column.max()) + 1) + column
    nearest = np.full(int(cell.max()) + 1, np.inf)
    np.minimum.at(nearest, cell, depth)
    slope = np.sqrt(1 - np.minimum(cosine, 1) ** 2) / np.maximum(cosine, 0.1)
    return depth > nearest[cell] + places.spacing * (1 + np.sqrt(2) * PITCH * slope)
