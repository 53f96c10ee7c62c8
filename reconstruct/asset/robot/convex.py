"""Convex parts of a mesh: simulators compute contacts between convex shapes only.

Concavities are cut where that helps most (CoACD; Wei, Liu, Ling and Su 2022, "Approximate Convex Decomposition for 3D Meshes with
Collision-Aware Concavity and Tree Search").
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from koala3d.reconstruct.errors import ReconstructError

if TYPE_CHECKING:
    import trimesh

PARTS = 32  # default largest number of parts
CONCAVITY = 0.05  # deepest dent that a part may fill, as a share of the mesh's size
CORNERS = 64  # largest number of vertices of a part, the limit of some simulators
FACES = 4000  # triangles that are searched for cuts
SEARCH = {"mcts_nodes": 10, "mcts_iterations": 60, "mcts_max_depth": 2}
"""A third of CoACD's search: a torus gets the same number of parts in a tenth of the time."""


def convex_parts(mesh: "trimesh.Trimesh", limit: int = PARTS) -> "tuple[trimesh.Trimesh, ...]":
    """Closed convex meshes that cover a mesh together, `limit` at most.

    A mesh that is not closed is first remeshed by CoACD.

    Raises ReconstructError: the mesh is flat, or nothing is found.
    """
    import coacd
    import trimesh

    coacd.set_log_level("error")
    searched = mesh.simplify_quadric_decimation(face_count=FACES) if len(mesh.faces) > FACES else mesh
    if mesh.is_watertight and not searched.is_watertight:  # an open mesh would be remeshed
        searched = mesh
    wanted = coacd.Mesh(np.asarray(searched.vertices, np.float64), np.asarray(searched.faces, np.int32))
    options: dict[str, Any] = {
        "threshold": CONCAVITY,
        "max_convex_hull": limit,
        "decimate": True,
        "max_ch_vertex": CORNERS,
        "seed": 0,
    }
    found = [trimesh.Trimesh(*part).convex_hull for part in coacd.run_coacd(wanted, **options, **SEARCH)]
    solid = tuple(part for part in found if part.is_volume)
    if not solid:
        why = f"{len(mesh.faces)} triangles, {' x '.join(f'{side:.3g}' for side in mesh.extents)} m"
        raise ReconstructError("the mesh has no convex parts", where="the mesh", why=why, remedy="look at it: reconstruct mesh")
    return solid
