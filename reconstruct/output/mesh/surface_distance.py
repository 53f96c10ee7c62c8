"""Distance of a reconstructed surface from the true one, where cameras see it.

Surface that no camera sees (the underside, the inside of a hollow solid) is not compared, nor is the floor of the object's box.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.reconstruct.output.mesh.nearest import POINTS, Nearest

if TYPE_CHECKING:
    import trimesh

FLOOR = 0.02
"""Share of the box's height, at its floor, that is not compared: there is the table."""
HIDDEN_PX = 4.0
"""A point is visible if it is less than this many pixel widths behind the nearest point at its pixel and the eight around."""
PICTURE_PX = 160  # longer side of the depth maps that determine visibility
DEFINITIONS = {
    "chamfer_mm": "mean of accuracy and completeness",
    "accuracy_mm": "mean distance from points of the mesh to the true surface",
    "completeness_mm": "mean distance from points of the true surface to the mesh",
    "f_score": "harmonic mean of the shares of both kinds of points that are closer than the threshold",
    "threshold_mm": "1 % of the diagonal of the true surface's bounding box",
}
"""Meaning of the metrics; all refer to surface that cameras see, above the floor of the object's box."""


@dataclass(frozen=True)
class Surface:
    """A mesh, points drawn on it, and which of them are compared."""

    mesh: "trimesh.Trimesh"
    points: NDArray[np.float64]  # (n, 3) [m]
    counts: NDArray[np.bool_]  # (n,) True inside the box, above its floor, and visible to a camera

    @classmethod
    def of(
        cls,
        mesh: "trimesh.Trimesh",
        views: tuple[View, ...],
        box: NDArray[np.float64],
        *,
        floor: float = FLOOR,
        count: int = POINTS,
    ) -> "Surface":
        """Points on `mesh`; those inside `box`, above its floor and visible in one of the `views` are compared."""
        from trimesh.sample import sample_surface

        points = np.asarray(sample_surface(mesh, count, seed=0)[0])
        low, high = box
        counts = ((points >= low) & (points <= high)).all(-1) & (points[:, 2] >= low[2] + floor * (high[2] - low[2]))
        counts &= visible(points, views)
        return cls(mesh, points, counts)

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) distance of (n, 3) points from the whole mesh [m], see `Nearest`."""
        return Nearest(self.mesh, count=len(self.points)).feet(points).distance


def compare(
    mesh: "trimesh.Trimesh",
    truth: "trimesh.Trimesh",
    views: tuple[View, ...],
    box: NDArray[np.float64],
    *,
    floor: float = FLOOR,
    count: int = POINTS,
) -> dict[str, float] | None:
    """Metrics of `DEFINITIONS` of a mesh [m]; None if no part of it or of the truth can be compared.

    Args:
        floor: see `FLOOR`; 0 where no table is in the box.
    """
    found, true = (Surface.of(surface, views, box, floor=floor, count=count) for surface in (mesh, truth))
    if not (found.counts.any() and true.counts.any()):
        return None
    accuracy, completeness = true.distance(found.points[found.counts]), found.distance(true.points[true.counts])
    threshold = 0.01 * float(np.linalg.norm(truth.extents))
    precision, recall = float(np.mean(accuracy < threshold)), float(np.mean(completeness < threshold))
    chamfer, f_score = (accuracy.mean() + completeness.mean()) / 2, 2 * precision * recall / max(precision + recall, 1e-12)
    means = {"chamfer_mm": chamfer, "accuracy_mm": accuracy.mean(), "completeness_mm": completeness.mean()}
    distances = {name: 1e3 * float(value) for name, value in means.items()}
    return {**distances, "f_score": f_score, "threshold_mm": 1e3 * threshold}


def visible(points: NDArray[np.float64], views: tuple[View, ...]) -> NDArray[np.bool_]:
    """(n,) True for points that one of the views sees, see `seen_by`."""
    found = np.zeros(len(points), bool)
    for view in views:
        found |= seen_by(points, view)
    return found


def seen_by(points: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """(n,) True for points that a view sees: inside its image and not behind other points.

    There must be about one point per pixel or more: larger images are reduced to `PICTURE_PX`.
    """
    from scipy.ndimage import minimum_filter

    camera = view.camera.undistorted()
    factor = min(1.0, PICTURE_PX / max(camera.width, camera.height))
    camera = camera.scaled(round(camera.width * factor), round(camera.height * factor))
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = np.flatnonzero(local[:, 2] > 1e-6)
    column, row = np.floor(camera.project(local[front])).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    front, pixel = front[inside], (row * camera.width + column)[inside]
    depth = local[front, 2]
    nearest = np.full(camera.width * camera.height, np.inf)
    np.minimum.at(nearest, pixel, depth)
    nearest = minimum_filter(nearest.reshape(camera.height, camera.width), 3).reshape(-1)  # no gaps between points
    found = np.zeros(len(points), bool)
    found[front] = depth < nearest[pixel] * (1 + HIDDEN_PX / camera.fx)
    return found
