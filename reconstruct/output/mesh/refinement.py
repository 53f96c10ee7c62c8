"""Refinement of a mesh by given normals: positions determine its overall shape, normals its detail.

A level set of the density is accurate on average but rough; predicted normals are smooth and more accurate in detail. Each
vertex v_i is moved along its normal n_i by the distance d_i that minimises

    sum_i A_i d_i^2 + L^2 sum_ij c_ij w_ij (n_ij . (v_j + d_j n_j - v_i - d_i n_i))^2

over vertices and edges, with the mean normal n_ij of an edge. It is the combination of positions and normals by Nehab,
Rusinkiewicz, Davis and Ramamoorthi (2005), "Efficiently combining positions and normals for precise 3D geometry", with
displacements along normals as unknowns. Areas A and cotangents c (Pinkall and Polthier 1993) make it independent of the
triangulation. The weight w is Cauchy's: the mesh stays unchanged where normals contradict it, at edges of the object and in
places that no image shows.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from koala3d.reconstruct.errors import ReconstructError

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

CREASE = 0.25  # slope of the mesh against its normals at which an edge counts half
COTANGENTS = (0.05, 3.0)  # bounds of an edge's cotangent weight: obtuse triangles must not make it negative, nor needles dominate
TOLERANCE = 1e-4  # relative residual of the solution
STEPS = 10_000  # maximum number of conjugate gradient steps; 300 are usual
ROUNDS = 20  # maximum number of rounds to correct folded triangles; few are needed


def follow_normals(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], normals: Float[np.ndarray, "v 3"], *, over: float
) -> Float[np.ndarray, "v 3"]:
    """Vertices moved along their normals so that the surface between them is perpendicular to the normals.

    Args:
        vertices: in any unit of length; every one belongs to a face.
        faces: vertex indices.
        normals: outward, of unit length, one for each vertex.
        over: L, the length below which slopes count more than positions, in the unit of the vertices.

    Raises ReconstructError: normals or vertices are not finite, or so uneven that there is no solution within `STEPS`.
    """
    from scipy import sparse

    vertices, normals = np.asarray(vertices, np.float64), np.asarray(normals, np.float64)
    for name, values in (("vertices", vertices), ("normals", normals)):
        if wrong := int(np.sum(~np.isfinite(values).all(-1))):
            raise _refusal(f"{wrong} of its {len(values)} {name} are not finite")
    areas, (start, end), cotangents = _areas_and_cotangents(vertices, faces)
    along, between = vertices[end] - vertices[start], normals[start] + normals[end]
    between /= np.maximum(np.linalg.norm(between, axis=-1, keepdims=True), 1e-9)  # opposite normals: no slope
    rise = np.sum(between * along, axis=-1)
    length = np.linalg.norm(along, axis=-1)
    slope = np.divide(rise, length, out=np.zeros_like(rise), where=length > 0)
    weights = over**2 * cotangents / (1 + (slope / CREASE) ** 2)
    edges = np.arange(len(rise))
    slopes = np.concatenate([-np.sum(between * normals[start], -1), np.sum(between * normals[end], -1)])
    places = (np.concatenate([edges, edges]), np.concatenate([start, end]))
    change = sparse.csr_matrix((slopes, places), shape=(len(rise), len(vertices)))
    pull = change.T @ sparse.diags(weights)
    system = sparse.diags(areas) + pull @ change
    distance = _solved(system, -pull @ rise)
    return vertices + _unfolded(distance, vertices, faces, normals)[:, None] * normals


def _solved(system: "csr_matrix", right: Float[np.ndarray, " v"]) -> Float[np.ndarray, " v"]:
    """Solution of a positive definite system by conjugate gradients, with the inverse diagonal as preconditioner.

    As `scipy.sparse.linalg.cg`, but the vectors stay where they are, and products of vectors are one loop each: those of
    BLAS are shared among threads, which wait for each other longer than they compute.
    """
    inverse, found, rest = 1 / system.diagonal(), np.zeros_like(right), right.copy()
    towards, direction, scaled, before = np.empty_like(right), np.zeros_like(right), np.empty_like(right), 1.0
    enough = TOLERANCE**2 * np.einsum("v,v", right, right)
    for _ in range(STEPS):
        if np.einsum("v,v", rest, rest) <= enough:
            return found
        np.multiply(inverse, rest, out=towards)
        now = np.einsum("v,v", rest, towards)
        direction *= now / before
        direction += towards
        image = system @ direction
        step = now / np.einsum("v,v", direction, image)
        found += np.multiply(direction, step, out=scaled)
        rest -= np.multiply(image, step, out=scaled)
        before = now
    raise _refusal(f"no solution within {STEPS} steps")


def _unfolded(
    distance: Float[np.ndarray, " v"],
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    normals: Float[np.ndarray, "v 3"],
) -> Float[np.ndarray, " v"]:
    """Distances that turn no triangle over: corners of one that did, always a needle of marching cubes, move by their mean."""
    near = faces  # those with a corner whose distance has changed: no other turns over now
    for _ in range(ROUNDS):
        before, after = (_doubled_areas(corners, near) for corners in (vertices, vertices + distance[:, None] * normals))
        folded = near[np.einsum("fx,fx->f", before, after) < 0].reshape(-1)
        if not len(folded):
            break
        means = np.repeat(distance[folded].reshape(-1, 3).mean(-1), 3)
        times = np.bincount(folded, minlength=len(distance))
        total = np.bincount(folded, means, minlength=len(distance))
        distance = np.where(times > 0, total / np.maximum(times, 1), distance)
        near = faces[(times > 0)[faces].any(-1)]
    return distance


def _doubled_areas(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 3"]:
    """Normals of the triangles with twice their area as length."""
    first, second, third = (vertices.T[:, faces[:, k]] for k in range(3))
    (a, b, c), (d, e, f) = second - first, third - first  # `np.cross` takes three times as long
    return np.stack([b * f - c * e, c * d - a * f, a * e - b * d], -1)


def _refusal(why: str) -> ReconstructError:
    problem, advice = "the mesh cannot follow the predicted normals", "reconstruct mesh --density-only keeps it unchanged"
    return ReconstructError(problem, where="the mesh", why=why, remedy=advice)


def _areas_and_cotangents(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, " v"], Int[np.ndarray, "2 e"], Float[np.ndarray, " e"]]:
    """A third of the triangles around each vertex; the edges; half the cotangents of the angles opposite to each, bounded."""
    from scipy import sparse

    count = len(vertices)
    corners = [vertices[faces[:, k]] for k in range(3)]
    doubled = np.linalg.norm(_doubled_areas(vertices, faces), axis=-1)
    doubled = np.maximum(doubled, 1e-9 * doubled.mean())  # marching cubes makes triangles without area
    opposite = []
    for k in range(3):
        here, one, other = (corners[(k + turn) % 3] for turn in range(3))
        opposite.append(np.sum((one - here) * (other - here), -1) / doubled / 2)
    ends = np.sort(np.stack([np.roll(faces, -1, axis=1), np.roll(faces, -2, axis=1)]).reshape(2, -1), axis=0)
    edges = sparse.csr_matrix((np.stack(opposite, -1).reshape(-1), tuple(ends)), shape=(count, count)).tocoo()
    areas = np.bincount(faces.reshape(-1), np.repeat(doubled / 6, 3), minlength=count)
    return areas, np.stack([edges.row, edges.col]), np.clip(edges.data, *COTANGENTS)
