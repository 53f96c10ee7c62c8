"""Pieces of an object that are not as drawn: one with a dent, one that is slightly too large.

A series of them tries whether shapes can be compared. Meshes are in the frame of the table [m].
"""

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

DEPTH, RADIUS, HEIGHT = 0.001, 0.012, 0.75
"""Of the dent [m], and how high it is on the object's side, as a share of the object's height."""
EDGE = 0.0012
"""Longest edge of the triangles about the dent [m]."""
LARGER = 1.003


def bounds(meshes: Sequence[trimesh.Trimesh]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) lowest and (3,) highest coordinates of several meshes."""
    return np.min([mesh.bounds[0] for mesh in meshes], axis=0), np.max([mesh.bounds[1] for mesh in meshes], axis=0)


def dented(meshes: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """The object with a round dent in the side that looks along y."""
    place, outward = _side(meshes)
    return [_pressed(_refined(mesh, place), place, outward) for mesh in meshes]


def enlarged(meshes: Sequence[trimesh.Trimesh]) -> list[trimesh.Trimesh]:
    """The object `LARGER` times as large, about the place where it stands."""
    lower, upper = bounds(meshes)
    motion = trimesh.transformations.scale_matrix(LARGER, [*(lower + upper)[:2] / 2, lower[2]])
    return [mesh.copy().apply_transform(motion) for mesh in meshes]


PIECES: dict[str, Callable[[Sequence[trimesh.Trimesh]], list[trimesh.Trimesh]]] = {"dented": dented, "enlarged": enlarged}


def _side(meshes: Sequence[trimesh.Trimesh]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3,) place of the dent, and (3,) outward normal there."""
    lower, upper = bounds(meshes)
    middle = (lower + upper) / 2
    origin = np.array([middle[0], upper[1] + 1.0, lower[2] + HEIGHT * (upper - lower)[2]])
    found = []
    for mesh in meshes:
        places, _, faces = mesh.ray.intersects_location([origin], [[0.0, -1.0, 0.0]])
        found += [(place[1], place, mesh.face_normals[face]) for place, face in zip(places, faces, strict=True)]
    _, place, outward = max(found, key=lambda one: one[0])
    return place, outward


def _pressed(mesh: trimesh.Trimesh, place: NDArray[np.float64], outward: NDArray[np.float64]) -> trimesh.Trimesh:
    """The mesh with vertices about a place moved inwards, by `DEPTH` in the middle."""
    squared = ((mesh.vertices - place) ** 2).sum(1) / RADIUS**2
    facing = mesh.vertex_normals @ outward > 0
    inwards = DEPTH * np.where(facing, np.maximum(1 - squared, 0) ** 2, 0)
    return trimesh.Trimesh(mesh.vertices - inwards[:, None] * outward, mesh.faces, process=False)


def _refined(mesh: trimesh.Trimesh, place: NDArray[np.float64]) -> trimesh.Trimesh:
    """The mesh with edges of at most `EDGE` where it is dented; edges are halved on both their sides, so that none tears."""
    mesh = mesh if mesh.is_watertight else trimesh.Trimesh(mesh.vertices, mesh.faces)  # which joins equal vertices
    while True:
        lengths, edges = mesh.edges_unique_length, mesh.faces_unique_edges
        longest = edges[np.arange(len(edges)), np.argmax(lengths[edges] + 1e-12 * edges, axis=1)]
        near = trimesh.triangles.closest_point(mesh.triangles, np.broadcast_to(place, (len(edges), 3)))
        near = np.linalg.norm(near - place, axis=1) < RADIUS
        wanted = np.zeros(len(lengths), bool)
        wanted[longest[near]] = lengths[longest[near]] > EDGE
        if not wanted.any():
            return mesh
        while True:  # an edge is halved only where it is the longest on both its sides
            further = wanted.copy()
            further[longest[wanted[edges].any(1)]] = True
            if (further == wanted).all():
                break
            wanted = further
        halved = wanted & (np.bincount(longest, minlength=len(lengths)) == np.bincount(edges.ravel(), minlength=len(lengths)))
        mesh = _halved(mesh, halved, longest)


def _halved(mesh: trimesh.Trimesh, halved: NDArray[np.bool_], longest: NDArray[np.int64]) -> trimesh.Trimesh:
    """The mesh with a new vertex on the middle of each `halved` edge, the `longest` of the faces at it."""
    new = np.cumsum(halved) - 1 + len(mesh.vertices)
    middles = mesh.vertices[mesh.edges_unique[halved]].mean(1)
    split = halved[longest]
    first = np.argmax(mesh.faces_unique_edges == longest[:, None], axis=1)  # corner at which a face's longest edge begins
    corners = np.take_along_axis(np.asarray(mesh.faces), (first[:, None] + np.arange(3)) % 3, axis=1)[split]
    middle = new[longest[split]]
    parts = [
        mesh.faces[~split],
        np.stack([corners[:, 0], middle, corners[:, 2]], -1),
        np.stack([middle, corners[:, 1], corners[:, 2]], -1),
    ]
    return trimesh.Trimesh(np.concatenate([mesh.vertices, middles]), np.concatenate(parts), process=False)
