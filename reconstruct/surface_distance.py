"""How far a reconstructed surface is from the true one, where cameras can see it.

Surface that no camera sees (the underside, the inside of a hollow solid) is not compared: nobody asked for it. Nor is the
floor of the object's box, on which the object stands.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datasets.scene import View

if TYPE_CHECKING:
    import trimesh

POINTS = 100_000
"""Points drawn on each surface."""
FLOOR = 0.02
"""This share of the box's height, at its floor, is not compared."""
HIDDEN_PX = 2.0
"""A point is seen if it is less than so many pixels' width behind the nearest point at its pixel."""
PICTURE_PX = 160
"""Longer side of the pictures in which it is decided what hides what."""
CANDIDATES = 4
"""Triangles whose true distance is computed, those of the nearest points drawn."""
DEFINITIONS = {
    "chamfer_mm": "mean of accuracy and completeness",
    "accuracy_mm": "mean distance from points of the mesh to the true surface",
    "completeness_mm": "mean distance from points of the true surface to the mesh",
    "f_score": "harmonic mean of the shares of both kinds of points that are closer than threshold_mm",
    "threshold_mm": "1 % of the diagonal of the true surface's bounding box",
}
"""What the figures mean; all of them are of surface that cameras see, above the floor of the object's box."""


@dataclass(frozen=True)
class Surface:
    """A mesh and points on those parts of it that count."""

    mesh: "trimesh.Trimesh"
    points: NDArray[np.float64]
    """(n, 3) [m]."""
    faces: NDArray[np.int64]
    """(n,) triangle of each point."""

    @classmethod
    def of(cls, mesh: "trimesh.Trimesh", views: tuple[View, ...], box: NDArray[np.float64], *, count: int = POINTS) -> "Surface":
        """Points of `mesh` inside `box`, above its floor, that one of the `views` sees."""
        from trimesh.sample import sample_surface

        points, faces = sample_surface(mesh, count, seed=0)
        low, high = box
        counts = ((points >= low) & (points <= high)).all(-1) & (points[:, 2] > low[2] + FLOOR * (high[2] - low[2]))
        counts &= seen(points, views)
        return cls(mesh, np.asarray(points)[counts], np.asarray(faces)[counts])

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) distance of (n, 3) points from the triangles that count [m].

        Exact where the nearest triangle is among those of the `CANDIDATES` nearest drawn points.
        """
        from scipy.spatial import cKDTree
        from trimesh.triangles import closest_point

        _, nearest = cKDTree(self.points).query(points, k=CANDIDATES)
        triangles = self.mesh.triangles[self.faces[nearest]].reshape(-1, 3, 3)
        repeated = np.repeat(points, CANDIDATES, axis=0)
        return np.linalg.norm(closest_point(triangles, repeated) - repeated, axis=-1).reshape(-1, CANDIDATES).min(-1)


def compare(mesh: "trimesh.Trimesh", truth: "trimesh.Trimesh", views: tuple[View, ...], box: NDArray[np.float64],
            *, count: int = POINTS) -> dict[str, float] | None:  # fmt: skip
    """Figures of `DEFINITIONS` of a mesh [m]; None where no part of it or of the truth counts."""
    found, true = (Surface.of(surface, views, box, count=count) for surface in (mesh, truth))
    if min(len(found.points), len(true.points)) < CANDIDATES:
        return None
    accuracy, completeness = true.distance(found.points), found.distance(true.points)
    threshold = 0.01 * float(np.linalg.norm(truth.extents))
    precision, recall = float(np.mean(accuracy < threshold)), float(np.mean(completeness < threshold))
    return {
        "chamfer_mm": 1e3 * float(accuracy.mean() + completeness.mean()) / 2,
        "accuracy_mm": 1e3 * float(accuracy.mean()), "completeness_mm": 1e3 * float(completeness.mean()),
        "f_score": 2 * precision * recall / max(precision + recall, 1e-12), "threshold_mm": 1e3 * threshold,
    }  # fmt: skip


def seen(points: NDArray[np.float64], views: tuple[View, ...]) -> NDArray[np.bool_]:
    """(n,) True for points of a surface that a view sees: in its picture and not behind others of the points.

    The points stand for the surface, several to a pixel: larger pictures are taken at `PICTURE_PX`.
    """
    found = np.zeros(len(points), bool)
    for view in views:
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
        found[front] |= depth < nearest[pixel] * (1 + HIDDEN_PX / camera.fx)
    return found
