"""Signed distance of one surface from another, with how certain it is, and the places where it is more than chance."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.output.mesh.nearest import Nearest
from koala3d.reconstruct.output.shape.alignment import Aligned, By, align
from koala3d.reconstruct.output.shape.places import Place, places, vertex_areas
from koala3d.reconstruct.output.shape.stated import Stated, finer

TOLERANCE = 1e-3
"""Default tolerance [m]."""
SIGNIFICANT = 3.0
"""Standard deviations from which a deviation is more than chance."""
FORMAT, VERSION = "koala-shape", 1
DEFINITIONS = {
    "deviation_m": "distance of A's surface from B's [m], positive where A is outside, over the part of A that can be compared, "
    "weighted by area; max is that of the largest magnitude",
    "within": "share of that area whose deviation is at most the tolerance",
    "significant_share": f"share of that area in connected places whose deviation exceeds {SIGNIFICANT:g} standard deviations",
    "places": "these places, largest first; where nothing is stated of either surface, those beyond the tolerance. A place's "
    "deviation is that at its core, its position is in the frame of B",
    "not_compared_share": "share of A's area beyond the edges of B, or where nothing is known of either surface",
    "aligned": "by: base, A was left where it stands in the frame of both; icp, A was moved from there; features, A was placed "
    "where it fits; scale: size of A relative to B, removed if scale_removed says so; would_move_m: how far icp moves A; matrix: "
    "takes points of A to B; covariance: of its error, a shift of A's middle on B [m^2] first, then a turn about it [rad^2]",
}


@dataclass(frozen=True)
class Comparison:
    """The first surface A, moved onto the second B, and its deviation at each of its vertices."""

    first: Stated
    """As it was given, but finer where nothing is stated; not moved."""
    second: Stated
    aligned: Aligned
    vertices: Float[np.ndarray, "v 3"]
    """Of A, in the frame of B [m]."""
    deviation: Float[np.ndarray, " v"]
    """Signed distance from B [m], positive outside."""
    std: Float[np.ndarray, " v"] | None
    """Its standard deviation [m]; None where nothing is stated of either surface."""
    compared: Bool[np.ndarray, " v"]
    areas: Float[np.ndarray, " v"]
    """Area around each vertex [m2]."""
    places: tuple[Place, ...]
    significant: Bool[np.ndarray, " v"]
    tolerance: float

    def to_json(self) -> dict[str, Any]:
        """Content of shape.json, see `DEFINITIONS`."""
        weights = np.where(self.compared, self.areas, 0.0)
        share = weights / weights.sum()
        order = np.argsort(self.deviation)
        sums = np.cumsum(share[order]) - share[order] / 2
        low, median, high = np.interp([0.05, 0.5, 0.95], sums, self.deviation[order])
        largest = self.deviation[np.argmax(np.abs(self.deviation) * self.compared)]
        figures = {
            "mean": np.sum(share * self.deviation),
            "median": median,
            "rms": np.sqrt(np.sum(share * self.deviation**2)),
            "p05": low,
            "p95": high,
            "max": largest,
        }
        inside = np.sum(share[np.abs(self.deviation) <= self.tolerance])
        return {
            "format": FORMAT,
            "version": VERSION,
            "aligned": self.aligned.to_json() | {"scale_removed": abs(self.aligned.fit.scale - 1) > 1e-9},
            "deviation_m": {name: float(value) for name, value in figures.items()},
            "within": {"tolerance_m": self.tolerance, "share": float(inside)},
            "std_m": None if self.std is None else float(np.sum(share * self.std)),
            "significant_share": None if self.std is None else float(np.sum(share[self.significant])),
            "places": [place.to_json() for place in self.places],
            "not_compared_share": float(1 - weights.sum() / self.areas.sum()),
            "definitions": DEFINITIONS,
        }


def compare(
    first: Stated, second: Stated, *, tolerance: float = TOLERANCE, by: By | None = None, scaled: bool = False
) -> Comparison:
    """Compare two surfaces [m].

    Args:
        tolerance: deviation up to which a piece is good [m].
        by, scaled: see `align`.

    Raises UsageError: see `align`; or no part of A can be compared.
    """
    first, target = finer(first), Nearest(second.mesh)
    aligned = align(first, second, target, by=by, scaled=scaled)
    vertices = aligned.fit.moved(np.asarray(first.mesh.vertices, np.float64))
    feet = target.feet(vertices)
    outward = target.at(feet, np.asarray(second.mesh.vertex_normals))
    deviation = feet.distance * np.where(np.sum((vertices - feet.points) * outward, -1) < 0, -1.0, 1.0)
    compared = ~target.on_an_edge(feet)
    for known in (first.known, None if second.known is None else target.at(feet, second.known.astype(float)) > 0.5):
        compared &= True if known is None else known
    faces = np.asarray(first.mesh.faces)
    areas = vertex_areas(first.mesh)
    if not areas[compared].sum() > 0:
        why = "nothing of A lies on B where both are known"
        raise UsageError("nothing can be compared", where=f"{first.name}, {second.name}", why=why, remedy="compare one object")
    std = _std(first, second, target, feet, aligned)
    limit = np.full(len(vertices), tolerance) if std is None else SIGNIFICANT * std
    found, significant = places(vertices, faces, areas, deviation, std, (np.abs(deviation) > limit) & compared)
    return Comparison(first, second, aligned, vertices, deviation, std, compared, areas, found, significant, tolerance)


def _std(first: Stated, second: Stated, target: Nearest, feet: Any, aligned: Aligned) -> Float[np.ndarray, " v"] | None:
    """Standard deviation of the difference at each vertex: of both surfaces, independent of each other.

    What is common to a whole surface, its place, counts only where it was left as it stands. The error of outlines
    counts only against a drawing: two runs have it in common.
    """
    variance = [one.deviation**2 for one in (first,) if one.deviation is not None]
    if second.deviation is not None:
        variance.append(target.at(feet, second.deviation) ** 2)
    if not variance:
        return None
    outlines = [one for one in (first, second) if one.outline is not None and one.outline.any()]
    if len(outlines) == 1:
        (one,) = outlines
        variance.append((one.outline if one is first else target.at(feet, one.outline)) ** 2)
    if aligned.by == "base":
        variance += [first.common**2] if first.common is not None else []
        variance += [target.at(feet, second.common) ** 2] if second.common is not None else []
    return np.sqrt(np.sum(np.stack(variance), 0))
