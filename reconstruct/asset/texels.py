"""The texels of an unwrapped mesh that lie on its surface, and where that is."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from koala3d.reconstruct.asset.unwrap import Unwrapped

MARGIN = 1e-6  # a texel on an edge, by barycentric coordinates, belongs to a triangle on either side


@dataclass(frozen=True)
class Texels:
    """n texels whose centres lie inside a triangle."""

    size: int
    """Width and height of the texture."""
    rows: Int[np.ndarray, " n"]
    """From the top of the texture, where v = 1."""
    columns: Int[np.ndarray, " n"]
    points: Float[np.ndarray, "n 3"]
    """In the frame and unit of the mesh."""
    normals: Float[np.ndarray, "n 3"]
    """Unit, interpolated from the vertices: what normal maps are relative to."""
    tangents: Float[np.ndarray, "n 3"]
    bitangents: Float[np.ndarray, "n 3"]

    def image(self, values: Num[np.ndarray, "n channels"]) -> Num[np.ndarray, "size size channels"]:
        """A texture with a value for each texel; the rest is filled from the nearest."""
        from scipy.ndimage import distance_transform_edt

        empty = np.ones((self.size, self.size), bool)
        empty[self.rows, self.columns] = False
        picture = np.zeros((self.size, self.size, values.shape[-1]), values.dtype)
        picture[self.rows, self.columns] = values
        _, (rows, columns) = distance_transform_edt(empty, return_indices=True)
        return picture[rows, columns]

    def to_tangent_space(self, normals: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Coordinates of vectors along tangent, bitangent and normal."""
        axes = (self.tangents, self.bitangents, self.normals)
        return np.stack([np.sum(normals * axis, -1) for axis in axes], -1)


def texels_of(mesh: Unwrapped, size: int) -> Texels:
    """All texels of a `size` x `size` texture on the mesh; where triangles meet, one of them owns the texel."""
    corners = mesh.uv[mesh.faces] * [size, -size] + [0.0, size]  # (f, 3, 2) columns and rows
    low = np.maximum(np.floor(corners.min(1) - 0.5), 0).astype(np.int64)
    high = np.minimum(np.ceil(corners.max(1) + 0.5), size).astype(np.int64)
    spans = np.maximum(high - low, 0)
    counts = spans.prod(-1)
    face = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns, rows = low[face, 0] + within % spans[face, 0], low[face, 1] + within // spans[face, 0]
    shares = _barycentric(corners, face, np.stack([columns + 0.5, rows + 0.5], -1))
    inside = (shares >= -MARGIN).all(-1)
    place, first = np.unique(rows[inside] * size + columns[inside], return_index=True)
    face, shares = face[inside][first], shares[inside][first][..., None]
    mean = lambda array: np.sum(array[mesh.faces[face]] * shares, axis=1)  # noqa: E731
    normals = _unit(mean(mesh.normals))
    tangents = mean(mesh.tangents)
    tangents = _unit(tangents - np.sum(tangents * normals, -1, keepdims=True) * normals)
    bitangents = mesh.signs[mesh.faces[face, 0]][:, None] * np.cross(normals, tangents)
    return Texels(size, place // size, place % size, mean(mesh.vertices), normals, tangents, bitangents)


def _barycentric(
    corners: Float[np.ndarray, "f 3 2"], face: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of points in the triangles with the given indices; -1 in those without area."""
    origin, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    doubled = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    usable: Bool[np.ndarray, " f"] = np.abs(doubled) > 1e-12
    inverse = np.where(usable, 1 / np.where(usable, doubled, 1.0), 0.0)[face]
    offset, first, second = points - origin[face], first[face], second[face]
    along = (offset[:, 0] * second[:, 1] - second[:, 0] * offset[:, 1]) * inverse
    up = (first[:, 0] * offset[:, 1] - offset[:, 0] * first[:, 1]) * inverse
    shares = np.stack([1 - along - up, along, up], -1)
    return np.where(usable[face][:, None], shares, -1.0)


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
