"""Connected places of a surface at which something holds."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    import trimesh

SMALLEST_VERTICES, SMALLEST_SHARE = 6, 1e-4
"""Fewer vertices, or a smaller share of the surface, are no place: single vertices exceed any bound by chance."""
CORE = 0.3
"""Radius of a place's core, as a share of the radius of a disc of the same area."""


@dataclass(frozen=True)
class Place:
    """A connected place of deviation."""

    point: Float[np.ndarray, " 3"]
    """Its core [m]."""
    deviation: float
    """At its core [m], signed."""
    std: float | None
    """Standard deviation of it [m]; None where it is not known."""
    area: float
    """[m2]."""

    def to_json(self) -> dict[str, Any]:
        """For a file."""
        return {"point_m": self.point.tolist(), "deviation_m": self.deviation, "std_m": self.std, "area_m2": self.area}


def vertex_areas(mesh: "trimesh.Trimesh") -> Float[np.ndarray, " v"]:
    """Area around each vertex: a third of each of its triangles."""
    return np.bincount(np.asarray(mesh.faces).reshape(-1), np.repeat(mesh.area_faces / 3, 3), minlength=len(mesh.vertices))


def places(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    areas: Float[np.ndarray, " v"],
    deviation: Float[np.ndarray, " v"],
    std: Float[np.ndarray, " v"] | None,
    holds: Bool[np.ndarray, " v"],
) -> tuple[tuple[Place, ...], Bool[np.ndarray, " v"]]:
    """The places where `holds` is true and the deviation has one sign, largest first, and which vertices belong to them."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    joined = holds[sides].all(-1) & (np.prod(np.sign(deviation[sides]), -1) > 0)
    links = csr_matrix((np.ones(joined.sum()), tuple(sides[joined].T)), shape=(len(vertices),) * 2)
    label = connected_components(links, directed=False)[1]
    label = np.where(holds, label, -1)
    counts = np.bincount(label[holds], minlength=1)
    sums = np.bincount(label[holds], areas[holds], minlength=1)
    kept = np.flatnonzero((counts >= SMALLEST_VERTICES) & (sums >= SMALLEST_SHARE * areas.sum()))
    kept = kept[np.argsort(-sums[kept])]
    found = tuple(_place(np.flatnonzero(label == one), vertices, areas, deviation, std) for one in kept)
    return found, np.isin(label, kept) & holds


def _place(
    members: Int[np.ndarray, " m"],
    vertices: Float[np.ndarray, "v 3"],
    areas: Float[np.ndarray, " v"],
    deviation: Float[np.ndarray, " v"],
    std: Float[np.ndarray, " v"] | None,
) -> Place:
    """A place from its vertices: its core is around the middle, weighted by the deviation."""
    area = float(areas[members].sum())
    weights = areas[members] * np.abs(deviation[members]) + 1e-30
    middle = np.average(vertices[members], axis=0, weights=weights)
    distance = np.linalg.norm(vertices[members] - middle, axis=-1)
    core = members[distance <= max(CORE * np.sqrt(area / np.pi), float(distance.min()) * 1.001)]
    shares = areas[core] + 1e-30
    point = vertices[members[distance.argmin()]]
    spread = None if std is None else float(np.average(std[core], weights=shares))
    return Place(point, float(np.average(deviation[core], weights=shares)), spread, area)
