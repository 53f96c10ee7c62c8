"""The object's box and the depth range of the cameras, from their poses and from surface points.

Depth is along the camera's z. Boxes are (2, 3): lower and upper corner in the world.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.scene import View

Box = NDArray[np.float64]

FEWEST_POINTS = 40
"""Smallest number of surface points for bounds; fewer may all lie on one part of the object."""
PARALLEL = 0.05
"""Axes whose directions spread less than this (mean squared sine about the mean) have no common point."""


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


def middle(world_from_camera: ArrayLike, box: ArrayLike) -> NDArray[np.float64]:
    """(3,) where (n, 4, 4) cameras look: their focus; for parallel axes the middle of the box."""
    centre, spread = focus(world_from_camera)
    return centre if spread > PARALLEL else np.asarray(box, np.float64).mean(0)


def grid(box: ArrayLike, cells: int | ArrayLike) -> NDArray[np.float64]:
    """(n, 3) centres of the cells into which a box is divided; `cells` along each side, or (3,) along each axis."""
    sides = zip(*np.asarray(box, np.float64), np.broadcast_to(np.asarray(cells), 3), strict=True)
    axes = [np.linspace(low, high, 2 * count + 1)[1::2] for low, high, count in sides]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


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
    """Cube about the cameras' common focus, as wide as the widest of their images there."""
    matrices = np.stack([view.world_from_camera for view in views])
    centre, _ = focus(matrices)
    distances = np.linalg.norm(matrices[:, :3, 3] - centre, axis=1)
    half = max(float(d) * half_field(view.camera) for d, view in zip(distances, views, strict=True))
    return np.stack([centre - half, centre + half])


def frustum_box(views: Sequence[View], near: float, far: float) -> Box:
    """Box about everything that the cameras see between two depths."""
    points = []
    for view in views:
        width, height = view.camera.width, view.camera.height
        rays = view.camera.directions([[0, 0], [width, 0], [0, height], [width, height]])
        visible = np.concatenate([rays * near, rays * far])
        points.append(visible @ view.world_from_camera[:3, :3].T + view.world_from_camera[:3, 3])
    stacked = np.concatenate(points)
    return np.stack([stacked.min(0), stacked.max(0)])


def surroundings(views: Sequence[View]) -> tuple[Box, float, float]:
    """(box, near, far) where the surroundings are visible and only the poses are known.

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


def about_points(views: Sequence[View], points: ArrayLike) -> tuple[Box, float, float] | None:
    """(box, near, far) from (n, 3) surface points; None where fewer than `FEWEST_POINTS` are in the common field of view.

    The box contains the middle 98% of the points that at least half of the cameras have in their images, with a margin of a
    twentieth on each side. Near is 0.8 of the nearest depth at which any camera has points (the first percentile), far twice the
    furthest, since surfaces without texture may be nearer or further.
    """
    points = np.asarray(points, np.float64)
    in_sight = np.zeros(len(points), int)
    nearest, furthest = np.inf, 0.0
    for view in views:
        depths = depths_in_picture(view, points)
        visible = np.isfinite(depths)
        in_sight += visible
        if visible.sum() >= FEWEST_POINTS // 4:
            low, high = np.quantile(depths[visible], (0.01, 0.99))
            nearest, furthest = min(nearest, float(low)), max(furthest, float(high))
    common = points[in_sight >= len(views) / 2]
    if len(common) < FEWEST_POINTS or not furthest:
        return None
    low, high = np.quantile(common, (0.01, 0.99), axis=0)
    margin = 0.05 * np.maximum(high - low, 0.05 * (high - low).max() + 1e-9)
    return np.stack([low - margin, high + margin]), 0.8 * nearest, 2 * furthest


def depths_in_picture(view: View, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) depth of each point that a view has in its image, NaN for the others; distortion is ignored."""
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = local[:, 2] > 0
    pixels = view.camera.undistorted().project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
    inside = front & ((pixels >= 0) & (pixels <= [view.camera.width, view.camera.height])).all(1)
    return np.where(inside, local[:, 2], np.nan)


def half_field(camera: Camera) -> float:
    """Tangent of the widest angle from the axis to the middle of an image edge."""
    right, bottom = camera.width - camera.cx, camera.height - camera.cy
    return max(camera.cx / camera.fx, right / camera.fx, camera.cy / camera.fy, bottom / camera.fy)
