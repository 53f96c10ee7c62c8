"""A mesh laid out flat: texture coordinates, and the tangents along them.

Charts and their packing are xatlas'. Vertices are repeated where charts meet, so that every vertex has one place in the texture.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from koala3d.reconstruct.errors import ReconstructError

if TYPE_CHECKING:
    import trimesh

PADDING = 4  # texels between charts, so that filtered textures do not bleed


@dataclass(frozen=True)
class Unwrapped:
    """A triangle mesh with texture coordinates. Lengths are those of the mesh it was made from."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    """Unit, outward."""
    tangents: Float[np.ndarray, "v 3"]
    """Unit, at right angles to the normals, towards growing u."""
    signs: Float[np.ndarray, " v"]
    """1 or -1: the bitangent, towards growing v, is sign * normal x tangent."""
    uv: Float[np.ndarray, "v 2"]
    """In 0..1; v grows upwards: the texture's last row is at v = 0."""
    faces: Int[np.ndarray, "f 3"]

    def moved(self, matrix: Float[np.ndarray, "4 4"]) -> "Unwrapped":
        """The same after a rigid motion."""
        turn = np.asarray(matrix)[:3, :3]
        vertices = self.vertices @ turn.T + np.asarray(matrix)[:3, 3]
        return replace(self, vertices=vertices, normals=self.normals @ turn.T, tangents=self.tangents @ turn.T)


def unwrap(mesh: "trimesh.Trimesh", size: int) -> Unwrapped:
    """Lay a mesh out on a texture of `size` x `size` texels.

    Raises ReconstructError: xatlas finds no layout.
    """
    import xatlas

    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    centre, reach = vertices.mean(0), max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    atlas, pack = xatlas.Atlas(), xatlas.PackOptions()
    pack.resolution, pack.padding, pack.bilinear = size, PADDING, True
    pack.texels_per_unit = 0.0  # as many as fit
    atlas.add_mesh((vertices - centre) / reach, faces, np.asarray(mesh.vertex_normals, np.float32))  # it drops tiny triangles
    atlas.generate(xatlas.ChartOptions(), pack)
    source, corners, uv = atlas[0]
    if not len(corners) or atlas.atlas_count != 1 or not np.isfinite(uv).all():
        why = f"{len(faces)} triangles, {atlas.chart_count} charts on {atlas.atlas_count} textures of {size} texels"
        raise ReconstructError("the mesh cannot be unwrapped", where="the mesh", why=why, remedy="try a larger --texture")
    places = np.asarray(uv, np.float64) * [atlas.width, atlas.height] / max(atlas.width, atlas.height)
    places[:, 1] = 1 - places[:, 1]
    positions, corners = mesh.vertices[source], np.asarray(corners, np.int64)
    normals = _vertex_normals(mesh)[source]
    tangents, signs = _tangents(positions, normals, places, corners)
    return Unwrapped(np.asarray(positions, np.float64), normals, tangents, signs, places, corners)


def _vertex_normals(mesh: "trimesh.Trimesh") -> Float[np.ndarray, "v 3"]:
    """Unit normals; where triangles without area have none, or opposite ones cancel out, that of the nearest vertex with one."""
    from scipy.spatial import KDTree

    normals = np.array(mesh.vertex_normals, np.float64)
    length = np.linalg.norm(normals, axis=-1)
    good, bad = np.flatnonzero(length > 1e-3), np.flatnonzero(length <= 1e-3)
    if not len(good):
        raise ReconstructError("the mesh has no normals", where="the mesh", why="all of its triangles are without area")
    normals[good] /= length[good, None]
    if len(bad):
        normals[bad] = normals[good][KDTree(mesh.vertices[good]).query(mesh.vertices[bad])[1]]
    return normals


def _tangents(
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    uv: Float[np.ndarray, "v 2"],
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, " v"]]:
    """Tangents and signs: mean over a vertex' triangles of the direction in which u grows, weighted by their area."""
    (a, b), (p, q) = (
        (array[faces[:, 1]] - array[faces[:, 0]], array[faces[:, 2]] - array[faces[:, 0]]) for array in (vertices, uv)
    )
    turn = np.sign(p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1])[:, None]
    along_u, along_v = turn * (q[:, 1:] * a - p[:, 1:] * b), turn * (p[:, :1] * b - q[:, :1] * a)
    sums = [np.zeros_like(vertices), np.zeros_like(vertices)]
    for total, values in zip(sums, (along_u, along_v), strict=True):
        for corner in range(3):
            np.add.at(total, faces[:, corner], values)
    across = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=-1)])  # for vertices whose triangles cancel out
    tangents = sums[0] - np.sum(sums[0] * normals, -1, keepdims=True) * normals
    length = np.linalg.norm(tangents, axis=-1, keepdims=True)
    tangents = np.where(length > 1e-20, tangents / np.maximum(length, 1e-20), across)
    tangents = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
    signs = np.where(np.sum(np.cross(normals, tangents) * sums[1], -1) < 0, -1.0, 1.0)
    return tangents, signs
