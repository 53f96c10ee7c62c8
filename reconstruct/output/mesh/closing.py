"""Keeps a closed mesh closed: every edge between two triangles, also after equal vertices are merged, as readers of files do.

Fewer triangles are made by collapsing edges (fast-simplification), which does not ask whether two sheets touch afterwards: an
edge then has four triangles. Marching cubes puts vertices onto each other where the surface meets a grid point.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    import trimesh

WELD = 1e-6
"""Vertices closer than this share of the mesh's size are one: single precision, in which files hold them, still tells others
apart."""


def is_closed(mesh: "trimesh.Trimesh") -> bool:
    """Whether triangles on both sides of each edge cancel out: for every one along it there is one against it."""
    return bool(len(mesh.faces)) and not _unpaired(_half_edges(np.asarray(mesh.faces))).any()


def mended(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """A closed mesh in which every edge has exactly two triangles; a mesh that is open is returned unchanged.

    Near vertices are merged, and triangles that thereby have no area are left out. The triangles at an edge with more than two
    are replaced: what they leave open is closed loop by loop, by triangles around the loop's middle. The loops exist because the
    mesh was closed: at each vertex as many open edges begin as end.
    """
    import trimesh

    if not is_closed(mesh):
        return mesh
    vertices, faces = _welded(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))
    half = _half_edges(faces)
    _, which, counts = np.unique(np.sort(half, -1), axis=0, return_inverse=True, return_counts=True)
    crowded = (counts[which.reshape(-1)] > 2).reshape(3, -1).any(0)  # three half edges of each face, one after another
    if crowded.any():
        faces = faces[~crowded]
        half = _half_edges(faces)
        loops = _loops(half[_unpaired(half)][:, ::-1], vertices)
        faces = np.concatenate([faces, *(_fan(loop, len(vertices) + number) for number, loop in enumerate(loops))])
        vertices = np.concatenate([vertices, *(vertices[loop].mean(0, keepdims=True) for loop in loops)])
    found = trimesh.Trimesh(vertices, faces, process=False)
    found.remove_unreferenced_vertices()
    return found


def _half_edges(faces: Int[np.ndarray, "f 3"]) -> Int[np.ndarray, "3f 2"]:
    """Start and end of each side of the triangles, in their order: all first sides, all second, all third."""
    return np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])


def _unpaired(half: Int[np.ndarray, "h 2"]) -> np.ndarray:
    """(h,) Which half edges lie on an edge that has more of them one way than the other."""
    ends = np.sort(half, -1)
    _, which = np.unique(ends, axis=0, return_inverse=True)
    which = which.reshape(-1)
    balance = np.bincount(which, np.sign(half[:, 1] - half[:, 0]))  # a side from a vertex to itself counts for nothing
    return balance[which] != 0


def _welded(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "g 3"]]:
    """Near vertices made one, triangles with fewer than three corners left out."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    pairs = KDTree(vertices).query_pairs(WELD * float(np.ptp(vertices, axis=0).max()), output_type="ndarray")
    links = csr_matrix((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(vertices), len(vertices)))
    _, first, label = np.unique(connected_components(links, directed=False)[1], return_index=True, return_inverse=True)
    faces = first[label.reshape(-1)][faces]
    a, b, c = faces.T
    return vertices, faces[(a != b) & (b != c) & (c != a)]


def _loops(half: Int[np.ndarray, "h 2"], vertices: Float[np.ndarray, "v 3"]) -> list[list[int]]:
    """Half edges as loops that pass no vertex twice. Where several go on from a vertex, the one with the nearest end does."""
    onward: dict[int, list[int]] = {}
    for start, end in half.tolist():
        onward.setdefault(start, []).append(end)
    found = []
    while onward:
        path = [next(iter(onward))]
        while True:
            here = path[-1]
            before = vertices[path[-2] if len(path) > 1 else here]
            end = min(onward[here], key=lambda other: float(np.linalg.norm(vertices[other] - before)))
            onward[here].remove(end)
            if not onward[here]:
                del onward[here]
            if end in path:
                found.append(path[path.index(end) :])
                path = path[: path.index(end) + 1]
                if len(path) == 1:
                    break
            else:
                path.append(end)
    return found


def _fan(loop: list[int], middle: int) -> Int[np.ndarray, "n 3"]:
    """Triangles between the sides of a loop and a vertex in its middle."""
    return np.array([(start, end, middle) for start, end in zip(loop, loop[1:] + loop[:1], strict=True)])
