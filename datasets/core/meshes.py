"""Mesh files: vertices and triangles."""

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.errors import UsageError

FORMATS = (".ply", ".obj", ".stl", ".off", ".glb")


@lru_cache(16)
def read_mesh(file: Path | str, scale: float = 1.0, what: str = "the mesh") -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices [m] and triangles of a mesh file; raises UsageError where it cannot be read.

    Args:
        scale: metres per unit of the file.
        what: what messages call it.
    """
    import trimesh

    path = Path(file)
    if path.suffix.lower() not in FORMATS or not path.is_file():
        why = "no such file" if not path.is_file() else f"'{path.suffix}' is no known suffix"
        raise UsageError(f"{what} cannot be read", where=path, why=why, remedy=f"give one of {', '.join(FORMATS)}")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # the readers of a dozen formats raise anything
        raise UsageError(f"{what} cannot be read", where=path, why=str(error)[:200]) from None
    if not len(faces) or not np.isfinite(vertices).all():
        raise UsageError(f"{what} cannot be read", where=path, why="it has no triangles, or a vertex is not finite")
    return vertices * scale, faces
