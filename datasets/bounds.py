"""Where the object is and how near and far the cameras see, from their geometry and masks.

Depth is along the camera's z. Boxes are (2, 3): lower and upper corner in the world.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datasets import images, pose
from datasets.camera_model import Camera
from datasets.scene import View

Box = NDArray[np.float64]

PARALLEL = 0.05
"""Axes whose directions spread less than this (mean squared sine about the common one) have no common point."""


def focus(world_from_camera: ArrayLike) -> tuple[NDArray[np.float64], float]:
    """The point nearest to all optical axes of (n, 4, 4) cameras, in the least-squares sense.

    Returns:
        (3,) the point, and how well the axes fix it: the smallest eigenvalue of the mean projection across the
        axes; 0 for parallel axes, 2/3 for axes from everywhere. Parallel axes give the point nearest to the cameras.
    """
    matrices = np.asarray(world_from_camera, np.float64).reshape(-1, 4, 4)
    axes, positions = matrices[:, :3, 2], matrices[:, :3, 3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    normal = across.mean(0)
    centre = positions.mean(0)
    offset = np.einsum("nij,nj->i", across, positions - centre) / len(matrices)
    return centre + np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ offset, float(np.linalg.eigvalsh(normal)[0])


def corners(box: ArrayLike) -> NDArray[np.float64]:
    """(8, 3) corners of a box."""
    box = np.asarray(box, np.float64)
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(8, 3)


def depth_range(views: Sequence[View], box: ArrayLike) -> tuple[float, float]:
    """Nearest and furthest depth of the box over all cameras; near stays above a hundredth of far."""
    points = np.concatenate([corners(box), np.ones((8, 1))], axis=1)
    depths = np.stack([(pose.inverse(view.world_from_camera) @ points.T)[2] for view in views])
    far = float(max(depths.max(), 1e-6))
    return max(float(depths.min()), 0.01 * far), far


def visible_box(views: Sequence[View]) -> Box:
    """Cube about the cameras' common focus that is as wide as the widest of their pictures there."""
    matrices = np.stack([view.world_from_camera for view in views])
    centre, _ = focus(matrices)
    distances = np.linalg.norm(matrices[:, :3, 3] - centre, axis=1)
    half = max(float(d) * _half_field(view.camera) for d, view in zip(distances, views, strict=True))
    return np.stack([centre - half, centre + half])


def frustum_box(views: Sequence[View], near: float, far: float) -> Box:
    """Box about everything that the cameras see between two depths."""
    points = []
    for view in views:
        width, height = view.camera.width, view.camera.height
        rays = view.camera.directions([[0, 0], [width, 0], [0, height], [width, height]])
        seen = np.concatenate([rays * near, rays * far])
        points.append(seen @ view.world_from_camera[:3, :3].T + view.world_from_camera[:3, 3])
    stacked = np.concatenate(points)
    return np.stack([stacked.min(0), stacked.max(0)])


def surroundings(views: Sequence[View]) -> tuple[Box, float, float]:
    """(box, near, far) where the surroundings are seen and nothing else is known.

    The box is a cube about the common focus, half as far on each side as the median camera; near is a twentieth of the
    nearest camera's distance to the focus; far is infinite. For parallel axes the unit of length is the cameras' spread.
    """
    matrices = np.stack([view.world_from_camera for view in views])
    centre, spread = focus(matrices)
    positions = matrices[:, :3, 3]
    if spread < PARALLEL:
        reach = float(np.linalg.norm(np.ptp(positions, axis=0))) or 1.0
        return frustum_box(views, reach, 10 * reach), 0.1 * reach, np.inf
    distances = np.linalg.norm(positions - centre, axis=1)
    half = 0.5 * float(np.median(distances))
    return np.stack([centre - half, centre + half]), 0.05 * float(distances.min()), np.inf


def mask_box(views: Sequence[View], box: ArrayLike, *, views_used: int = 24, resolution: int = 48) -> Box:
    """`box` tightened to the visual hull: what no alpha or mask declares empty.

    Conservative: masks are widened by half a voxel's diagonal as each camera sees it. Three passes, each in
    the box that the last one found.
    """
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, views_used).round().astype(int))]
    masks = [_mask(view) for view in chosen]
    result = np.asarray(box, np.float64)
    for _ in range(3):
        voxel = (result[1] - result[0]) / resolution
        axes = [result[0, k] + voxel[k] * (np.arange(resolution) + 0.5) for k in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        seen = np.zeros(len(points), int)
        for view, mask in zip(chosen, masks, strict=True):
            counted, possible = _carve(view, mask, points, float(np.linalg.norm(voxel)) / 2)
            points, seen = points[possible], (seen + counted)[possible]
        kept = points[seen >= max(len(chosen) // 4, 1)]
        if not len(kept):
            return np.asarray(box, np.float64)
        result = np.stack([np.maximum(kept.min(0) - voxel, result[0]), np.minimum(kept.max(0) + voxel, result[1])])
    return result


_CELL = 2
"""Pixels per side of a mask cell."""


def _mask(view: View) -> NDArray[np.bool_]:
    """(rows, columns) of mask cells: True where any pixel belongs to the object."""
    picture = images.read(view.mask or view.image)
    inside = picture[..., 0 if view.mask else -1] > 0
    height, width = inside.shape
    padded = np.pad(inside, ((0, -height % _CELL), (0, -width % _CELL)))
    cells = padded.reshape(padded.shape[0] // _CELL, _CELL, padded.shape[1] // _CELL, _CELL)
    return np.any(cells, axis=(1, 3))


def _carve(view: View, mask: NDArray[np.bool_], points: NDArray[np.float64],
           radius: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:  # fmt: skip
    """Which (n, 3) points this view sees at all, and which it allows to belong to the object, as (n,) each."""
    from scipy.ndimage import maximum_filter

    camera = view.camera
    seen, possible = np.zeros(len(points), bool), np.ones(len(points), bool)
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = local[:, 2] > 2 * radius
    safe_depth = np.where(front, local[:, 2], 1.0)
    index = np.flatnonzero(front & (np.abs(local[:, :2]).max(1) < 1.5 * _half_field(camera) * safe_depth))  # a sane lens there
    pixels = camera.project(local[index])
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
    index, pixels = index[inside], pixels[inside]
    if not len(index):
        return seen, possible
    footprint = radius * max(camera.fx, camera.fy) / (float(local[index, 2].min()) - radius) / _CELL
    wide = maximum_filter(mask, size=2 * int(np.ceil(footprint)) + 1, mode="nearest")
    column, row = (pixels / _CELL).astype(int).T
    seen[index] = True
    possible[index] = wide[row, column]
    return seen, possible


def _half_field(camera: Camera) -> float:
    """Tangent of the widest angle from the axis to an edge's middle."""
    return max(camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx,
               camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy)  # fmt: skip
