"""Flat Gaussians that cover a surface: their places, sizes and orientations."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from koala3d.datasets import pose

if TYPE_CHECKING:
    import trimesh

CANDIDATES = 6  # points drawn at random for each that is kept
APART = 0.8
"""Smallest distance of two points times the square root of their number per area: the most that a random order can hold."""
NEIGHBOURS = 6
WIDTH = 0.65
"""Standard deviation in the surface, as a share of the mean distance to the nearest points: 1 % of light gets through."""
FLATNESS = 0.1
"""Standard deviation along the normal, as a share of that."""


@dataclass(frozen=True)
class Surfels:
    """n flat Gaussians, in the frame and unit of the mesh."""

    points: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "n 3 3"]
    """Columns: two directions in the surface, and the outward normal."""
    scales: Float[np.ndarray, "n 3"]
    """Standard deviations along these."""

    @property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        """Outward, of unit length."""
        return self.rotations[:, :, 2]

    @property
    def quaternions(self) -> Float[np.ndarray, "n 4"]:
        """Of the rotations, w first."""
        return pose.quaternion(self.rotations)


def cover(mesh: "trimesh.Trimesh", count: int) -> Surfels:
    """At most `count` surfels, spread evenly over a mesh."""
    from scipy.spatial import KDTree

    apart = APART * np.sqrt(mesh.area / count)
    points, normals = _drawn(mesh, CANDIDATES * count)
    kept = _far_apart(_sided(points, normals, apart), apart)[:count]
    points, normals = points[kept], normals[kept]
    places = _sided(points, normals, apart)
    distances = KDTree(places).query(places, k=min(NEIGHBOURS + 1, len(places)))[0]
    width = WIDTH * np.minimum(distances[:, 1:].mean(-1), 3 * apart)
    across = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), -1)])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    rotations = np.stack([across, np.cross(normals, across), normals], -1)
    return Surfels(points, rotations, np.stack([width, width, FLATNESS * width], -1))


def sided(surfels: Surfels) -> Float[np.ndarray, "n 6"]:
    """Places in which surfels on the two sides of a thin wall are far from each other."""
    return _sided(surfels.points, surfels.normals, 2 * float(surfels.scales[:, 0].mean()))


def _drawn(mesh: "trimesh.Trimesh", count: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Random points of a mesh with its normals there."""
    import trimesh
    from trimesh.sample import sample_surface

    points, triangles = sample_surface(mesh, count, seed=0)[:2]
    shares = trimesh.triangles.points_to_barycentric(mesh.triangles[triangles], points)[..., None]
    normals = np.sum(mesh.vertex_normals[mesh.faces[triangles]] * shares, axis=1)
    return np.asarray(points), normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)


def _sided(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], apart: float) -> Float[np.ndarray, "n 6"]:
    return np.concatenate([points, apart * normals], -1)


def _far_apart(places: Float[np.ndarray, "n k"], apart: float) -> Int[np.ndarray, " m"]:
    """Indices of places none of which is nearer to another than `apart`: as if each were taken in turn if it has room.

    Rounds instead of turns: a place is taken when all earlier ones around it are refused.
    """
    from scipy.spatial import KDTree

    pairs = np.sort(KDTree(places).query_pairs(apart, output_type="ndarray"), -1)
    taken: Bool[np.ndarray, " n"] = np.zeros(len(places), bool)
    open_ = np.ones(len(places), bool)
    while open_.any():
        waits = np.zeros(len(places), bool)
        waits[pairs[:, 1]] = True
        new = open_ & ~waits
        taken |= new
        refused = np.zeros(len(places), bool)
        refused[pairs[new[pairs[:, 0]], 1]] = True
        open_ &= ~new & ~refused
        pairs = pairs[open_[pairs].all(-1)]
    return np.flatnonzero(taken)
