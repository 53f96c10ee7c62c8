"""Standard deviation of each vertex of a mesh that was extracted from a trained model.

Errors of single places are taken to be normal along the surface's normal, with the variance

    (PIXEL pixel / sqrt(views))^2 + (SLOPE slope pixel)^2 + (DEPTH depth)^2 / views

of `Evidence`: what pictures resolve, and the more of them the better; how far the density's normals and the predicted ones
disagree; and what outlines leave open behind them, where nothing but colours and reflections say how deep the surface is. The
three numbers are fitted to rendered scenes whose true shape is known (`python -m tests.bench.shape_coverage`, docs/shape.md).
What moves the whole object is in `common`, and the error that all outlines share in `outline`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from koala3d.datasets.core import files
from koala3d.reconstruct.output.shape import common, evidence
from koala3d.reconstruct.output.shape.evidence import Evidence
from koala3d.reconstruct.output.shape.places import vertex_areas
from koala3d.reconstruct.output.trained_model import TrainedModel

if TYPE_CHECKING:
    import trimesh

FORMAT, VERSION = "koala-certainty", 1
FILE = "certainty.json"
"""In a run, written by `reconstruct mesh`."""
NUMBERS = (0.23, 2.46, 1.93)
"""PIXEL, SLOPE and DEPTH."""
EXPECTED, SPREAD = 0.48, 0.59
"""Mean error of an object over its mean standard deviation, and the standard deviation of the logarithm of that ratio among
objects. Normal errors have 0.80; these have long tails, which the band is made to hold."""
BAND = 1.96
"""Standard deviations on either side within which 95 % of normal errors are."""
OUTLINE = 0.7
"""Pixels by which outlines that were found in the pictures are off: alike for pieces that were recorded alike, so their
differences do not have it."""
FEWEST_VIEWS, LEAST_SPREAD = 3, np.deg2rad(5.0)
"""Views that have to see a place, and how different their directions have to be, so that anything is known of it."""
MIRROR, MIRROR_VIEWS = 0.5, 8
"""A surface that reflects more than this share needs so many views: fewer do not tell a mirror from a hollow."""
WIDEST = 0.05
"""Deviation, as a share of the object's size, from which nothing is known; the deviation of what nothing is known of."""
NO_OUTLINE = 20.0
"""Pixels that a surface counts as deep at most, and where there are no masks."""
DEFINITIONS = {
    "median_std": "median over the known surface of the standard deviation of a place along its normal, without what is common",
    "known_share": "share of the surface of which anything is known: the rest is seen by too few views, for a mirror by few",
    "expected_error": "mean distance from the known surface to the true one that is to be expected, as the Chamfer distance "
    "measures it, and its 95 % interval",
    "scale_std": "relative standard deviation of the size from the calibration; null where the scene states none",
    "place_std": "standard deviation of the place per axis from the calibration; null where the scene states none",
}
"""Of `Uncertain.summary`; lengths in the scene's world unit."""


@dataclass(frozen=True)
class Uncertain:
    """Errors to be expected of v vertices along their normals, in the scene's world unit."""

    deviation: Float[np.ndarray, " v"]
    """Standard deviation of what differs from place to place."""
    known: Bool[np.ndarray, " v"]
    """Where anything is known; elsewhere the deviation is `WIDEST` of the object's size."""
    areas: Float[np.ndarray, " v"]
    """Area around each vertex."""
    common: Float[np.ndarray, " v"]
    """Standard deviation by what moves the whole object; 0 where the scene states no calibration."""
    outline: Float[np.ndarray, " v"]
    """Standard deviation that all outlines share, see `OUTLINE`; 0 where masks were not found in the pictures."""
    scale_std: float | None
    place_std: float | None
    metric: bool
    """Whether lengths are metres."""

    def summary(self) -> dict[str, Any]:
        """For a file of results, see `DEFINITIONS`."""
        areas = np.where(self.known, self.areas, 0.0)
        known = float(areas.sum() / self.areas.sum())
        found: dict[str, Any] = {"median_std": None, "known_share": known, "expected_error": None}
        if known > 0:
            order = np.argsort(self.deviation)
            middle = np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)
            mean = EXPECTED * float(np.average(np.hypot(self.deviation, self.outline), weights=areas))
            interval = [mean * float(np.exp(side * BAND * SPREAD)) for side in (-1, 1)]
            found |= {"median_std": float(self.deviation[order[middle]]), "expected_error": {"value": mean, "interval": interval}}
        return found | {
            "scale_std": self.scale_std,
            "place_std": self.place_std,
            "metric": self.metric,
            "definitions": DEFINITIONS,
        }


def of(trained: TrainedModel, mesh: "trimesh.Trimesh") -> Uncertain:
    """What is to be expected of a mesh of a trained model, in the world frame with outward normals."""
    found = evidence.of(trained, mesh)
    size = float(np.linalg.norm(mesh.extents))
    local, known = deviations(found, NUMBERS), is_known(found)
    known &= local < WIDEST * size
    points = np.asarray(mesh.vertices, np.float64)
    whole = common.of(trained.scene, points[known] if known.any() else points)
    return Uncertain(
        np.where(known, local, WIDEST * size),
        known,
        vertex_areas(mesh),
        np.zeros(len(points)) if whole is None else whole.along(points, np.asarray(mesh.vertex_normals)),
        found.pixel * (OUTLINE if trained.scene.masks_were_found else 0.0),
        None if whole is None else whole.scale_std,
        None if whole is None else whole.place_std,
        trained.scene.metric,
    )


def store(run: Path, step: int, certain: Uncertain) -> None:
    """Keep the summary in the run, for its report."""
    files.write_json(run / FILE, {"format": FORMAT, "version": VERSION, "steps": step, **certain.summary()})


def stored(run: Path, step: int) -> dict[str, Any] | None:
    """The summary that is kept in a run, if it belongs to this state of it."""
    if not (run / FILE).is_file():
        return None
    found: dict[str, Any] = files.read_json(run / FILE, kind=FORMAT, version=VERSION)
    return found if found.get("steps") == step else None


def text(certain: Uncertain) -> str:
    """The summary for a person."""
    found = certain.summary()
    if found["expected_error"] is None:
        return "nothing is known of where the true surface is: too few views see it"
    factor, unit = (1e3, "mm") if certain.metric else (1.0, "units")
    low, high = (factor * value for value in found["expected_error"]["interval"])
    line = (
        f"expected error {factor * found['expected_error']['value']:.3g} {unit} ({low:.3g} to {high:.3g}), "
        f"{found['known_share']:.0%} of the surface is known"
    )
    return line if found["scale_std"] is None else f"{line}, its size to {found['scale_std']:.2%} by the calibration"


def deviations(found: Evidence, numbers: tuple[float, ...]) -> Float[np.ndarray, " v"]:
    """Standard deviations from evidence and the fitted numbers."""
    return np.sqrt(sum((number * term) ** 2 for number, term in zip(numbers, terms(found), strict=True)))


def terms(found: Evidence) -> tuple[Float[np.ndarray, " v"], ...]:
    """What the numbers multiply, in the unit of the evidence."""
    root = np.sqrt(np.maximum(found.views, 1))
    return found.pixel / root, found.slope * found.pixel, np.minimum(found.depth, NO_OUTLINE * found.pixel) / root


def is_known(found: Evidence) -> Bool[np.ndarray, " v"]:
    """Where enough views see the surface from directions that differ."""
    enough = np.where(found.mirror > MIRROR, MIRROR_VIEWS, FEWEST_VIEWS)
    return (found.views >= enough) & (found.spread >= LEAST_SPREAD)
