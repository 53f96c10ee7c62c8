"""The visual hull: the space that no alpha and no mask marks as empty. Its box is a safe bound of the object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets.imaging import images
from datasets.scene import View
from datasets.structure.bounds import Box, depth_range, half_field


@dataclass(frozen=True, eq=False)
class Hull:
    """The space that an object can occupy."""

    box: Box
    """(2, 3) corners."""
    centres: NDArray[np.float64]
    """(n, 3) centres of its voxels."""
    radius: float
    """Half the diagonal of a voxel [world unit]."""
    views_used: int
    """Number of views whose masks were read; 0 where they exclude everything and the hull is the initial box."""

    def depth_range(self, views: Sequence[View]) -> tuple[float, float]:
        """Least and greatest depth of the hull over all cameras; near stays above a hundredth of far."""
        least, greatest = depth_range(views, self.box)
        if not self.views_used:
            return least, greatest
        nearest, furthest = np.inf, 1e-6
        for view in views:
            depths = (self.centres - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, 2]
            nearest, furthest = min(nearest, float(depths.min())), max(furthest, float(depths.max()))
        return max(nearest - self.radius, least), min(furthest + self.radius, greatest)


def visual_hull(views: Sequence[View], box: ArrayLike, *, views_used: int = 64, resolution: int = 48) -> Hull:
    """The part of `box` that at least a third of the views see and no mask marks as empty.

    Conservative: masks are dilated by half a projected voxel diagonal. Three passes, each in the box of the previous one.
    """
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, views_used).round().astype(int))]
    masks = [_mask(view) for view in chosen]
    start = result = np.asarray(box, np.float64)
    kept, radius = np.zeros((0, 3)), 0.0
    for _ in range(3):
        voxel = (result[1] - result[0]) / resolution
        axes = [result[0, k] + voxel[k] * (np.arange(resolution) + 0.5) for k in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        radius = float(np.linalg.norm(voxel)) / 2
        visible = np.zeros(len(points), int)
        for view, mask in zip(chosen, masks, strict=True):
            counted, possible = _carve(view, mask, points, radius)
            points, visible = points[possible], (visible + counted)[possible]
        kept = points[visible >= max(len(chosen) // 3, 1)]
        if not len(kept):
            return Hull(start, points, radius, 0)
        result = np.stack([np.maximum(kept.min(0) - voxel, result[0]), np.minimum(kept.max(0) + voxel, result[1])])
    return Hull(result, kept, radius, len(chosen))


_CELL = 2
"""Pixels per side of a mask cell."""


def _mask(view: View) -> NDArray[np.bool_]:
    """(rows, columns) mask cells: True where any pixel belongs to the object."""
    inside = (view.read_mask() if view.mask else images.read(view.image))[..., -1] > 0
    height, width = inside.shape
    padded = np.pad(inside, ((0, -height % _CELL), (0, -width % _CELL)))
    cells = padded.reshape(padded.shape[0] // _CELL, _CELL, padded.shape[1] // _CELL, _CELL)
    return np.any(cells, axis=(1, 3))


def _carve(
    view: View, mask: NDArray[np.bool_], points: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) flags of the (n, 3) points: which this view sees, and which its mask does not exclude."""
    from scipy.ndimage import maximum_filter

    camera = view.camera
    visible, possible = np.zeros(len(points), bool), np.ones(len(points), bool)
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = local[:, 2] > 2 * radius
    safe_depth = np.where(front, local[:, 2], 1.0)
    index = np.flatnonzero(
        front & (np.abs(local[:, :2]).max(1) < 1.5 * half_field(camera) * safe_depth)
    )  # where the lens model is valid
    pixels = camera.project(local[index])
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
    index, pixels = index[inside], pixels[inside]
    if not len(index):
        return visible, possible
    footprint = radius * max(camera.fx, camera.fy) / (float(local[index, 2].min()) - radius) / _CELL
    wide = maximum_filter(mask, size=2 * int(np.ceil(footprint)) + 1, mode="nearest")
    column, row = (pixels / _CELL).astype(int).T
    visible[index] = True
    possible[index] = wide[row, column]
    return visible, possible
