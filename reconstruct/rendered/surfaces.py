"""Surfaces of solids as meshes: marching cubes, then vertices are moved onto the surface along the normals."""

import numpy as np
from numpy.typing import NDArray

from koala3d.reconstruct.rendered.tracer import Tracer

MESH_CELLS = 160
"""Cells per axis of the grid for marching cubes."""


def surface_of(tracer: Tracer, cells: int = MESH_CELLS) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.int64]]:
    """(n, 3) vertices and outward unit normals, (m, 3) faces of all solids together; unit of the tracer."""
    from skimage.measure import marching_cubes

    axis = np.linspace(-1, 1, cells + 1, dtype=np.float32)
    slices = []
    for x in axis:
        y, z = np.meshgrid(axis, axis, indexing="ij")
        points = np.stack([np.full_like(y, x), y, z], -1).reshape(-1, 3)
        slices.append(tracer.measured(points)[0].reshape(y.shape))
    vertices, faces, _, _ = marching_cubes(np.stack(slices), 0.0, spacing=(2 / cells,) * 3)
    points = vertices.astype(np.float32) - 1
    for _ in range(3):
        distance, normal = tracer.measured(points)
        points = points - distance[:, None] * normal
    return points.astype(np.float64), tracer.measured(points)[1], faces.astype(np.int64)
