"""The points of a surface that are closest to given ones."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    import trimesh

POINTS = 100_000
"""Points drawn on the surface."""
NEAR_THE_END = 0.9
"""Share of the way from a triangle's inner corner to the surface's edge from which a drawn point counts as on the edge."""
ON_A_SIDE = 1e-9
"""Barycentric coordinate below which a foot is on a side of its triangle."""
ROUNDS = 20
"""Most triangles on the way to the closest one."""
CANDIDATES = 4
"""Triangles of each kind that are tried."""


@dataclass(frozen=True)
class Feet:
    """Closest points on a surface."""

    points: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    """At least 0, in the unit of the mesh."""


@dataclass(frozen=True)
class Planes:
    """Tangent planes of a surface, one for each of n points."""

    height: Float[np.ndarray, " n"]
    """Of the point above the plane."""
    normals: Float[np.ndarray, "n 3"]
    """Outward, unit."""
    distance: Float[np.ndarray, " n"]
    """From the point where plane and surface meet."""
    points: Float[np.ndarray, "n 3"]
    """Where they meet."""
    triangles: Int[np.ndarray, " n"]
    """On which they meet."""
    at_an_edge: Bool[np.ndarray, " n"]
    """Whether the surface ends there."""


class Nearest:
    """Finds closest points on one mesh.

    The search begins at the triangles of the `CANDIDATES` nearest drawn points, which finds large triangles, and of the nearest
    centroids, which finds small ones. From a foot on a triangle's side it goes on to the triangle behind that side,
    as long as that is closer.
    """

    def __init__(self, mesh: "trimesh.Trimesh", *, count: int = POINTS) -> None:
        """Prepare a mesh with triangles; `count` points are drawn on it, always the same ones."""
        from scipy.spatial import KDTree
        from trimesh.sample import sample_surface

        points, faces = (np.asarray(one) for one in sample_surface(mesh, count, seed=0)[:2])
        self.mesh, self._triangles = mesh, np.asarray(mesh.triangles)
        self._places = tuple(
            (KDTree(at), of) for at, of in ((points, faces), (mesh.triangles_center, np.arange(len(mesh.faces))))
        )
        ends = np.sort(np.asarray(mesh.edges), -1)
        _, which, counts = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
        which, count = which.reshape(-1), len(mesh.faces)
        order = np.argsort(which, kind="stable")  # sides of one edge follow each other
        pairs = np.flatnonzero(which[order][1:] == which[order][:-1])
        behind = np.repeat(np.arange(count), 3)  # where nothing is behind a side, the triangle itself
        owner = np.repeat(np.arange(count), 3)
        behind[order[pairs]], behind[order[pairs + 1]] = owner[order[pairs + 1]], owner[order[pairs]]
        self._behind = behind.reshape(count, 3)
        self._open = np.zeros(len(mesh.vertices))
        self._open[ends[counts[which] == 1]] = 1.0
        self._drawn = Feet(points, faces, np.zeros(len(points)))
        self._ends = self.at(self._drawn, self._open) > NEAR_THE_END

    def planes(self, points: Float[np.ndarray, "n 3"]) -> Planes:
        """Tangent planes of the surface near points: of the closest of the drawn points, which is fast and nearly the closest."""
        distance, which = self._places[0][0].query(points)
        triangles = self._drawn.triangles[which]
        normals = np.asarray(self.mesh.face_normals)[triangles]
        height = np.sum((points - self._drawn.points[which]) * normals, -1)
        return Planes(height, normals, distance, self._drawn.points[which], triangles, self._ends[which])

    def some(self, count: int) -> Float[np.ndarray, "count 3"]:
        """Some of the drawn points."""
        return self._drawn.points[np.random.default_rng(0).permutation(len(self._drawn.points))[:count]]

    def feet(self, points: Float[np.ndarray, "n 3"]) -> Feet:
        """The closest points to the given ones."""
        from trimesh.triangles import closest_point

        best, triangles, distance = points.copy(), np.zeros(len(points), np.int64), np.full(len(points), np.inf)
        for tree, faces in self._places:
            _, nearest = tree.query(points, k=min(CANDIDATES, len(faces)))
            for candidate in faces[nearest].reshape(len(points), -1).T:
                on_triangle = closest_point(self._triangles[candidate], points)
                apart = np.linalg.norm(on_triangle - points, axis=-1)
                closer = apart < distance
                best[closer], triangles[closer], distance[closer] = on_triangle[closer], candidate[closer], apart[closer]
        found = Feet(best, triangles, distance)
        going = np.flatnonzero(self.shares(found).min(-1) < ON_A_SIDE)
        for _ in range(ROUNDS):
            gone = np.zeros(len(going), bool)
            for behind in self._behind[triangles[going]].T:
                on_triangle = closest_point(self._triangles[behind], points[going])
                apart = np.linalg.norm(on_triangle - points[going], axis=-1)
                closer = apart < distance[going] * (1 - 1e-9)
                at = going[closer]
                best[at], triangles[at], distance[at] = on_triangle[closer], behind[closer], apart[closer]
                gone |= closer
            going = going[gone]
            if not len(going):
                break
        return found

    def shares(self, feet: Feet) -> Float[np.ndarray, "n 3"]:
        """Barycentric coordinates of feet in their triangles, in 0..1; alike for the corners of one without area."""
        from trimesh.triangles import points_to_barycentric

        triangles, shares = self._triangles[feet.triangles], np.full((len(feet.points), 3), 1 / 3)
        across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        has_area = np.sum(across * across, -1) > 0
        shares[has_area] = points_to_barycentric(triangles[has_area], feet.points[has_area], method="cross")
        shares = np.clip(shares, 0, 1)
        return shares / np.maximum(shares.sum(-1, keepdims=True), 1e-12)

    def at(self, feet: Feet, values: Float[np.ndarray, "v *channels"]) -> Float[np.ndarray, "n *channels"]:
        """Values of the mesh's vertices, interpolated at feet."""
        corners = np.asarray(self.mesh.faces)[feet.triangles]
        return np.einsum("nk,nk...->n...", self.shares(feet), values[corners])

    def on_an_edge(self, feet: Feet) -> Bool[np.ndarray, " n"]:
        """Which feet are where the surface ends: what is beyond has nothing to be compared with."""
        return self.at(feet, self._open) > 1 - 1e-6
