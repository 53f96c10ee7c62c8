"""Mesh files, and points drawn on a mesh."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from koala3d.datasets.core.files import atomic_path

if TYPE_CHECKING:
    import trimesh

SUFFIXES = (".ply", ".glb", ".obj")


def save(mesh: "trimesh.Trimesh", path: Path) -> None:
    """Write a mesh, or points without faces, atomically with normals and colours; the suffix names the format."""
    with atomic_path(path) as temporary:
        options = {"include_normals": True} if path.suffix.lower() in (".glb", ".obj") else {"vertex_normal": True}
        mesh.export(temporary, file_type=path.suffix.lower()[1:], **options)


def points_on(mesh: "trimesh.Trimesh", count: int, seed: int = 0) -> "trimesh.Trimesh":
    """`count` points spread evenly over a mesh, with its normals and colours, as a mesh without faces."""
    import trimesh
    from trimesh.sample import sample_surface

    points, triangles = sample_surface(mesh, count, seed=seed)[:2]
    visual: Any = mesh.visual
    shares = trimesh.triangles.points_to_barycentric(mesh.triangles[triangles], points)[..., None]
    corners = mesh.faces[triangles]
    colours = np.sum(visual.vertex_colors[corners][..., :3] * shares, axis=1)
    normals = np.sum(mesh.vertex_normals[corners] * shares, axis=1)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    rounded = np.clip(np.round(colours), 0, 255).astype(np.uint8)
    no_faces = np.zeros((0, 3), np.int64)
    return trimesh.Trimesh(np.asarray(points), no_faces, vertex_normals=normals, vertex_colors=rounded, process=False)
