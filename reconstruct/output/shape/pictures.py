"""Pictures of a coloured surface from a few sides, drawn with points: no graphics card, no window."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

if TYPE_CHECKING:
    import trimesh

SIDES = {
    "from -y": (0.0, -1.0, 0.0),
    "from +x": (1.0, 0.0, 0.0),
    "from +y": (0.0, 1.0, 0.0),
    "from -x": (-1.0, 0.0, 0.0),
    "from +z": (0.0, 0.0, 1.0),
    "from -z": (0.0, 0.0, -1.0),
}
"""Names and directions towards the viewer."""
POINTS, PIXELS, MARGIN = 600_000, 300, 0.04
"""Points on the surface, width and height of a picture, and what stays free at its edges."""
AMBIENT = 0.45
"""Brightness of what is seen edge-on; what faces the viewer has 1."""
BELOW, MIDDLE, ABOVE = np.array([0.13, 0.35, 0.80]), np.array([0.93, 0.93, 0.90]), np.array([0.80, 0.16, 0.12])
UNKNOWN = np.array([0.55, 0.55, 0.58])
"""sRGB of the lowest deviation, of none, of the highest, and of what is not compared."""


def colours(values: Float[np.ndarray, " n"], limit: float) -> Float[np.ndarray, "n 3"]:
    """sRGB in 0..1 of values from -limit (blue) to limit (red)."""
    share = np.clip(values / limit, -1, 1)[:, None]
    return MIDDLE + np.where(share < 0, -share * (BELOW - MIDDLE), share * (ABOVE - MIDDLE))


def views(mesh: "trimesh.Trimesh", shown: Float[np.ndarray, "v 3"]) -> dict[str, UInt8[np.ndarray, "h w 3"]]:
    """Pictures of a mesh with an sRGB colour at each vertex, without perspective, all at the same scale."""
    from trimesh.sample import sample_surface

    points, triangles = (np.asarray(one) for one in sample_surface(mesh, POINTS, seed=0)[:2])
    corners, near = np.asarray(mesh.triangles)[triangles], np.asarray(mesh.faces)[triangles]
    weights = 1 / np.maximum(np.linalg.norm(corners - points[:, None], axis=-1), 1e-12)  # enough for a picture
    tone = np.einsum("nk,nkc->nc", weights / weights.sum(-1, keepdims=True), shown[near])
    normals = np.asarray(mesh.face_normals)[triangles]
    middle, reach = mesh.bounds.mean(0), (0.5 + MARGIN) * float(mesh.extents.max())
    return {name: _picture(points - middle, normals, tone, np.array(side), reach) for name, side in SIDES.items()}


def _picture(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    tone: Float[np.ndarray, "n 3"],
    towards: Float[np.ndarray, " 3"],
    reach: float,
) -> UInt8[np.ndarray, "h w 3"]:
    """One side: the nearest point of each pixel, holes of single pixels filled from their neighbours."""
    from scipy.ndimage import distance_transform_edt

    up = np.array([0.0, 1.0, 0.0]) if abs(towards[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, towards)
    column = np.floor((points @ right / reach + 1) * PIXELS / 2).astype(int)
    row = np.floor((1 - points @ up / reach) * PIXELS / 2).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < PIXELS) & (row < PIXELS)
    order = np.flatnonzero(inside)[np.argsort((points @ towards)[inside], kind="stable")]  # the nearest is written last
    bright = AMBIENT + (1 - AMBIENT) * np.abs(normals[order] @ towards)[:, None]
    picture, covered = np.ones((PIXELS, PIXELS, 3)), np.zeros((PIXELS, PIXELS), bool)
    picture[row[order], column[order]] = tone[order] * bright
    covered[row[order], column[order]] = True
    away, (rows, columns) = distance_transform_edt(~covered, return_indices=True)
    holes = (away > 0) & (away < 1.1) & (distance_transform_edt(covered | (away < 1.1)) > 1.5)
    picture[holes] = picture[rows[holes], columns[holes]]
    return np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8)
