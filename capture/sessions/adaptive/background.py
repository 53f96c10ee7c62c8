"""Which pixels show the table: there, pictures from all sides agree about the colour of the point of the table behind the pixel.

What stands on the table does not lie in its plane, so a picture that shows it disagrees with the others. Colours are compared in
patches, since single pixels agree by chance. What is not shown to be table counts as the object: masks are never too small
because of the room behind it, only too large, and other views make up for that.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.structure.masks.silhouette import Silhouette

Array = NDArray[np.float64]
Picture = NDArray[np.float32]

REACH_M, STEP_M = 0.6, 0.005
"""Half the side of the part of the table that is compared, and the distance of its points [m]."""
PATCH = 3
"""Points along the side of a patch."""
SAME = 0.02
"""Mean difference of sRGB in a patch up to which it shows the table. Dark and clear objects differ little from it."""
FEWEST = 3
"""Pictures that must agree."""
HEIGHTS_M = np.arange(-0.012, 0.0121, 0.003)
"""How far the table may be above or below where the trajectory has it."""
COARSE = 2
"""Distance of the points by which its height is found, in those of `STEP_M`."""
SMOOTH_PX = 0.7
"""Blur of the pictures before they are compared: noise is less than what differs."""
MOST = 0.1
"""Largest difference of sRGB that counts: what the object adds says nothing about the table."""


@dataclass(frozen=True, eq=False)
class Outline:
    """What one picture says about the space before the table."""

    foreground: Silhouette
    """Pixels that are not shown to be table: the object's, and those that tell nothing."""
    silent: Silhouette
    """Pixels that tell nothing: behind them is no part of the table that enough pictures show."""


def table_height(
    pictures: Sequence[Picture], cameras: Sequence[Camera], world_from_camera: Array, middle: Array, table_z: float
) -> float:
    """The height about `table_z` at which the pictures differ least; arguments as in `outlines` [m]."""
    blurred, heights = _blurred(pictures), table_z + HEIGHTS_M
    points = [_points(middle, height, COARSE * STEP_M) for height in heights]
    return float(heights[int(np.argmin([_difference(*_shown(blurred, cameras, world_from_camera, one)) for one in points]))])


def outlines(
    pictures: Sequence[Picture], cameras: Sequence[Camera], world_from_camera: Array, middle: Array, table_z: float
) -> list[Outline]:
    """Where pictures show something other than the table.

    Args:
        pictures: (height, width, 3) sRGB from 0 to 1 each.
        cameras: with the pictures' sizes.
        world_from_camera: (m, 4, 4) [m].
        middle: (2,) of the part of the table that is looked at [m].
        table_z: of its top [m].
    """
    colours, shown = _shown(_blurred(pictures), cameras, world_from_camera, _points(middle, table_z, STEP_M))
    agreeing, compared, found = _agreeing(colours, shown), shown.sum(0) >= FEWEST, []
    for camera, pose, table in zip(cameras, world_from_camera, agreeing, strict=True):
        inside, silent = (~_looked_up(one, camera, pose, middle, table_z) for one in (table, compared))
        inside = cv2.medianBlur(inside.astype(np.uint8), 5) > 0
        found.append(Outline(Silhouette(camera, pose, inside), Silhouette(camera, pose, silent)))
    return found


def _blurred(pictures: Sequence[Picture]) -> list[Picture]:
    return [np.asarray(cv2.GaussianBlur(picture, (0, 0), SMOOTH_PX), np.float32) for picture in pictures]


def _points(middle: Array, table_z: float, step: float) -> Array:
    """(rows, columns, 3) points of the table, `step` apart [m]."""
    steps = np.arange(-REACH_M, REACH_M, step)
    return np.stack([*np.meshgrid(middle[0] + steps, middle[1] + steps), np.full((len(steps),) * 2, table_z)], -1)


def _shown(
    pictures: Sequence[Picture], cameras: Sequence[Camera], world_from_camera: Array, points: Array
) -> tuple[Picture, NDArray[np.bool_]]:
    """(m, rows, columns, 3) colours of points of the table in each picture, and (m, rows, columns) which of them it shows."""
    found = [_sampled(*one, points) for one in zip(pictures, cameras, world_from_camera, strict=True)]
    return np.stack([colours for colours, _ in found]), np.stack([inside for _, inside in found])


def _sampled(picture: Picture, camera: Camera, world_from_camera: Array, points: Array) -> tuple[Picture, NDArray[np.bool_]]:
    """(rows, columns, 3) colours of points of the table in a picture, and (rows, columns) which of them it shows."""
    local = (points - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
    ahead = local[..., 2] > STEP_M
    pixels = camera.project(np.where(ahead[..., None], local, [0.0, 0.0, 1.0]))
    inside = ahead & (pixels >= 1).all(-1) & (pixels < [camera.width - 1, camera.height - 1]).all(-1)
    at = np.where(inside[..., None], pixels - 0.5, 0.0).astype(np.float32)  # OpenCV's first pixel is at zero
    return np.asarray(cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR), np.float32), inside


def _difference(colours: Picture, inside: NDArray[np.bool_]) -> float:
    """How much pictures differ from the usual colour, over the points that enough of them show: mean of medians [sRGB]."""
    enough = inside.sum(0) >= FEWEST
    if not enough.any():
        return MOST
    colours, inside = colours[:, enough][:, None], inside[:, enough][:, None]
    differences = np.minimum(np.abs(colours - _median(colours, inside)).max(-1), np.float32(MOST))
    return float(_median(differences[..., None], inside).mean())


def _agreeing(colours: Picture, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(m, rows, columns) whether each picture shows at a point of the table what most pictures show there."""
    usual = _median(colours, inside)
    alike = np.stack([_patch_mean(np.abs(one - usual).max(-1), seen) < SAME for one, seen in zip(colours, inside, strict=True)])
    alike &= inside
    return alike & (alike.sum(0) >= FEWEST)


def _median(colours: Picture, inside: NDArray[np.bool_]) -> Picture:
    """(rows, columns, channels) median over the pictures that show each point; 0 where none does."""
    ordered = np.sort(np.where(inside[..., None], colours, np.float32(2.0)), axis=0)
    middle = np.maximum(inside.sum(0) - 1, 0) // 2
    usual = np.take_along_axis(ordered, middle[None, ..., None], axis=0)[0]
    shown = np.asarray(inside.any(0))
    return np.where(shown[..., None], usual, np.float32(0.0))


def _patch_mean(values: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    weights = inside.astype(np.float32)
    total = cv2.blur(np.where(inside, values, 0).astype(np.float32), (PATCH, PATCH))
    return np.asarray(total / np.maximum(cv2.blur(weights, (PATCH, PATCH)), 1e-3), np.float32)


def _looked_up(
    table: NDArray[np.bool_], camera: Camera, world_from_camera: Array, middle: Array, table_z: float
) -> NDArray[np.bool_]:
    """(height, width) the value of `table` at the point of the table behind each pixel; False elsewhere."""
    ways = camera.directions(camera.pixel_centres()) @ world_from_camera[:3, :3].T
    height = table_z - world_from_camera[2, 3]
    towards = ways[..., 2] * np.sign(height) > 1e-6
    along = height / np.where(towards, ways[..., 2], np.sign(height) or 1.0)
    places = world_from_camera[:2, 3] + along[..., None] * ways[..., :2]
    column, row = np.moveaxis(np.round((places - middle + REACH_M) / STEP_M), -1, 0)
    there = towards & (column >= 0) & (row >= 0) & (column < table.shape[1]) & (row < table.shape[0])
    found = np.zeros((camera.height, camera.width), bool)
    found[there] = table[row[there].astype(int), column[there].astype(int)]
    return found
