"""Bodies that stand around an arm, as a rig file lists them: boxes, cylinders and meshes. Lengths in metres, base frame."""

from abc import abstractmethod
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from koala3d.capture.model.shapes.distances import box_distance, least
from koala3d.capture.model.shapes.geometry import PoseDescription
from koala3d.datasets import pose
from koala3d.datasets.core.meshes import FORMATS, read_mesh
from koala3d.datasets.core.schema import Schema

Array = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0, le=100)]
SPACING_M = 0.01  # of the points along a segment whose distances from a mesh are measured
STRIDE = 8  # every so many of these points are measured first
EDGE_M, MAX_POINTS = 0.008, 300_000
"""A mesh is refined until no edge is longer, or more for a mesh that would get more points than this."""
OBSTACLE = "the mesh of an obstacle"


class Solid(Schema):
    """A body at a place."""

    name: str = Field(min_length=1, description="what a person calls it")
    pose: PoseDescription = Field(default_factory=PoseDescription, description="base_from_body: where it stands")

    def distance(self, ends: Array) -> Array:
        """(...) distance [m] of (..., 2, 3) line segments in the base from the body; 0 where they meet."""
        body_from_base = pose.inverse(self.pose.matrix())
        return self._from_own(ends @ body_from_base[:3, :3].T + body_from_base[:3, 3])

    @abstractmethod
    def _from_own(self, ends: Array) -> Array:
        """`distance` in the body's own frame."""

    @abstractmethod
    def outline(self) -> tuple[Array, NDArray[np.int64]]:
        """(n, 3) vertices in the base [m] and (m, 3) triangles, for drawings."""

    def _placed(self, vertices: Array) -> Array:
        base_from_body = self.pose.matrix()
        return np.asarray(vertices @ base_from_body[:3, :3].T + base_from_body[:3, 3])


class BoxSolid(Solid):
    """A box with its centre in its origin, along the axes of its frame."""

    kind: Literal["box"] = Field(description="kind of body")
    size: tuple[Positive, Positive, Positive] = Field(description="full extent along its x, y, z [m]")

    def _from_own(self, ends: Array) -> Array:
        half = np.array(self.size) / 2
        return box_distance(ends, np.stack([-half, half]))

    def outline(self) -> tuple[Array, NDArray[np.int64]]:
        """See `Solid`."""
        import trimesh

        box = trimesh.creation.box(np.array(self.size))
        return self._placed(np.asarray(box.vertices)), np.asarray(box.faces)


class CylinderSolid(Solid):
    """A cylinder with its centre in its origin, along its z axis."""

    kind: Literal["cylinder"] = Field(description="kind of body")
    radius: float = Field(gt=0, le=10, description="radius [m]")
    height: float = Field(gt=0, le=10, description="full extent along its z [m]")

    def _from_own(self, ends: Array) -> Array:
        def distance(t: Array) -> Array:
            point = ends[..., 0, :] + t[..., None] * (ends[..., 1, :] - ends[..., 0, :])
            aside = np.maximum(np.linalg.norm(point[..., :2], axis=-1) - self.radius, 0.0)
            return np.hypot(aside, np.maximum(np.abs(point[..., 2]) - self.height / 2, 0.0))

        return least(distance, ends.shape[:-2])

    def outline(self) -> tuple[Array, NDArray[np.int64]]:
        """See `Solid`."""
        import trimesh

        cylinder = trimesh.creation.cylinder(self.radius, self.height, sections=32)
        return self._placed(np.asarray(cylinder.vertices)), np.asarray(cylinder.faces)


class MeshSolid(Solid):
    """A triangle mesh. Only its surface counts: an arm that is inside a closed mesh has a part that goes through it."""

    kind: Literal["mesh"] = Field(description="kind of body")
    file: str = Field(min_length=1, description=f"path of the mesh, relative to the rig file: {', '.join(FORMATS)}")
    scale: float = Field(default=1.0, gt=0, le=1000, description="metres per unit of the file")

    def _from_own(self, ends: Array) -> Array:
        """Distance to points that are close together on the surface, less what may lie between them: at most 5 mm too short."""
        tree, between = _surface(self.file, self.scale)
        length = float(np.linalg.norm(ends[..., 1, :] - ends[..., 0, :], axis=-1).max(initial=0.0))
        count = int(np.ceil(length / SPACING_M)) + 1
        share = np.linspace(0.0, 1.0, max(count, 2))[:, None]
        points = ends[..., None, 0, :] + share * (ends[..., None, 1, :] - ends[..., None, 0, :])
        nearest = _least_along(tree, points)
        half = length / max(count - 1, 1) / 2  # the nearest point of the segment is at most this far from one that was measured
        return np.maximum(np.sqrt(np.maximum(nearest**2 - half**2, 0.0)) - between, 0.0)

    def outline(self) -> tuple[Array, NDArray[np.int64]]:
        """See `Solid`."""
        vertices, faces = read_mesh(self.file, self.scale, OBSTACLE)
        return self._placed(vertices), faces


AnySolid = Annotated[BoxSolid | CylinderSolid | MeshSolid, Field(discriminator="kind")]


def _least_along(tree: Any, points: Array) -> Array:
    """(...) smallest distance [m] of (..., n, 3) points along segments, n > 1, from those of a search tree.

    A distance differs between two places by no more than they are apart, so most points need no search.
    """
    lines = points.reshape(-1, *points.shape[-2:])
    looked = np.arange(0, lines.shape[1], STRIDE)
    nearest = np.full(lines.shape[:2], np.inf)
    nearest[:, looked] = tree.query(lines[:, looked])[0]
    found = nearest.min(axis=1)
    last = looked[np.arange(lines.shape[1]) // STRIDE]
    apart = np.linalg.norm(lines - lines[:, last], axis=-1)
    left = ~np.isfinite(nearest) & (nearest[:, last] - apart <= found[:, None])
    nearest[left] = tree.query(lines[left])[0]
    return np.asarray(nearest.min(axis=1).reshape(points.shape[:-2]))


@lru_cache(16)
def _surface(file: str, scale: float) -> tuple[Any, float]:
    """Points on the surface of a mesh as a search tree, and how far a point of the surface is from one of them at most [m]."""
    import trimesh
    from scipy.spatial import KDTree

    vertices, faces = read_mesh(file, scale, OBSTACLE)
    corners = vertices[faces]
    area = float(0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1).sum())
    edge = max(EDGE_M, float(np.sqrt(4 * area / MAX_POINTS)))  # halving leaves triangles of about a quarter of the squared edge
    points, _ = trimesh.remesh.subdivide_to_size(vertices, faces, max_edge=edge, max_iter=20)
    return KDTree(points), edge / np.sqrt(3)
