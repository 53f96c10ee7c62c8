"""Where one surface lies on another: as both stand in their frame, from there on, or wherever they fit."""

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.output.mesh.nearest import Nearest
from koala3d.reconstruct.output.shape.motion import Fit, Samples, Target, closest
from koala3d.reconstruct.output.shape.stated import Stated

By = Literal["base", "features", "icp"]
BY: tuple[By, ...] = get_args(By)
POINTS, FEW, LEAST = 6000, 600, 150
"""Points of the first surface that are fitted, with which few poses are followed, and with which many are tried."""
TURNS, TRIED, KEPT, COARSE = 400, 4, 12, 3000
"""Rotations that are tried, about 27 degrees apart, steps for all of them, how many are followed, and points of the second
surface in those steps."""
OVERLAP = 0.02
"""Usual distance, in sizes of the second surface, up to which two surfaces overlap as they stand."""
APART = 0.08
"""Usual distance beyond which they do not belong together wherever they are."""
THOUSAND, HUNDRED, INCH = (400.0, 2500.0), (60.0, 160.0), (20.0, 32.0)
"""Ratios of size that a wrong unit explains: of millimetres, centimetres and inches."""
OTHER_DEG, AS_GOOD = 20.0, 1.1
"""A pose turned by more that fits almost as well: which of them it is, is not known."""


@dataclass(frozen=True)
class Aligned:
    """How the first surface was placed on the second."""

    by: By
    fit: Fit
    """What was applied."""
    scale: float
    """Size of the first surface relative to the second, whether it was removed or not."""
    scale_std: float
    """Its standard deviation, from how much patches of both surfaces disagree."""
    moved_m: float
    """How far the middle of the first surface was moved."""
    turned_deg: float
    would_move_m: float
    """With `base`: how far ICP would have moved it."""
    ambiguous: bool
    """Whether another pose fits as well, as for a symmetric object."""

    def to_json(self) -> dict[str, Any]:
        """For a file."""
        kept = ("by", "moved_m", "turned_deg", "scale", "scale_std", "would_move_m", "ambiguous")
        fit = {name: getattr(self.fit, name).tolist() for name in ("matrix", "middle", "covariance")}
        return {name: getattr(self, name) for name in kept} | fit


def align(first: Stated, second: Stated, nearest: Nearest, *, by: By | None = None, scaled: bool = False) -> Aligned:
    """Place the first surface on the second.

    Args:
        nearest: of the second surface's mesh.
        by: `base` leaves it where it is, `icp` begins there, `features` tries everywhere. None: where they overlap as they stand,
            `base` if both have errors stated, as meshes of runs do that are in their robot's frame, else `icp`; `features`
            where they do not overlap.
        scaled: remove the difference in size as well.

    Raises UsageError: they do not overlap; their sizes suggest different units.
    """
    check_units(first, second)
    samples, target, middle = _drawn(first), Target(nearest, second.variance), first.mesh.bounds.mean(0)
    overlap = float(np.median(nearest.planes(samples.some(FEW).points).distance)) < OVERLAP * second.size
    if by is None:
        stated = first.deviation is not None and second.deviation is not None
        by = "features" if not overlap else "base" if stated else "icp"
    if by == "base" and not overlap:
        remedy = "without --align they are brought together"
        raise UsageError("the surfaces do not overlap as they stand", where=f"{first.name}, {second.name}", remedy=remedy)
    start, ambiguous = _found(samples, target, first, second) if by == "features" else (np.eye(4), False)
    fit = closest(samples, target, start)
    if not fit.usual < APART * min(first.size, second.size):
        why = f"at their best fit they are usually {1e3 * fit.usual:.3g} mm apart"
        raise UsageError("the surfaces do not fit", where=f"{first.name}, {second.name}", why=why, remedy="compare one object")
    with_scale = closest(samples, target, fit.matrix, scaled=True)
    would = fit.motion(middle)[0]
    if scaled:
        fit = with_scale
    if by == "base":
        still = Fit(np.eye(4), 1.0, 0.0, middle, np.zeros((6, 6)))
        fit = _about(still, with_scale.scale, middle) if scaled else still
    moved, turned = fit.motion(middle)
    return Aligned(by, fit, with_scale.scale, with_scale.scale_std, moved, turned, would, ambiguous)


def check_units(first: Stated, second: Stated) -> None:
    """Raise UsageError where the ratio of both sizes is one of units."""
    ratio = second.size / first.size
    names = {"mm": THOUSAND, "cm": HUNDRED, "in": INCH}
    for unit, (low, high) in names.items():
        large, other = (second, first) if ratio > 1 else (first, second)
        if low <= max(ratio, 1 / ratio) <= high:
            why = f"{large.size:.4g} m across, {other.name} is {other.size:.4g} m"
            remedy = f"if it is in {unit}: --unit {unit}" if large is second else f"write it in metres if it is in {unit}"
            raise UsageError("unit is probably not the metre", where=large.name, why=why, remedy=remedy)


def _drawn(surface: Stated) -> Samples:
    """Points spread over a surface."""
    from trimesh.sample import sample_surface

    points, faces = sample_surface(surface.mesh, POINTS, seed=1)[:2]
    order = np.random.default_rng(0).permutation(len(points))
    faces = faces[order]
    return Samples(np.asarray(points)[order], np.asarray(surface.mesh.face_normals)[faces], surface.variance[faces])


def _about(fit: Fit, scale: float, middle: Float[np.ndarray, " 3"]) -> Fit:
    """The fit with a scale about a point that stays."""
    matrix = np.eye(4)
    matrix[:3, :3] /= scale
    matrix[:3, 3] = middle - middle / scale
    return replace(fit, matrix=matrix, scale=scale)


def _found(samples: Samples, target: Target, first: Stated, second: Stated) -> tuple[Float[np.ndarray, "4 4"], bool]:
    """A pose to begin at, and whether one that is turned otherwise fits as well.

    Features of the whole surfaces are compared: their middles, put on each other, and all rotations about them, improved in a few
    steps with a few points.
    """
    few = samples.some(FEW)
    turns = pose.rotations(TURNS)
    starts = np.tile(np.eye(4), (TURNS, 1, 1))
    starts[:, :3, :3], starts[:, :3, 3] = turns, second.mesh.centroid - turns @ first.mesh.centroid
    followed = [closest(few, target, start, steps=30) for start in _improved(starts, samples.some(LEAST).points, target.nearest)]
    misfits = [_misfit(fit, few, target) for fit in followed]
    chosen = followed[int(np.argmin(misfits))]
    others = [_turned(fit, chosen) for fit, misfit in zip(followed, misfits, strict=True) if misfit < AS_GOOD * min(misfits)]
    return chosen.matrix, max(others) > OTHER_DEG


def _improved(
    starts: Float[np.ndarray, "k 4 4"], points: Float[np.ndarray, "n 3"], target: Nearest
) -> Float[np.ndarray, "kept 4 4"]:
    """The best of many poses after a few steps from point to point (Besl and McKay 1992), all poses at once."""
    from scipy.spatial import KDTree

    surface, poses = target.some(COARSE), starts
    tree = KDTree(surface)
    for step in range(TRIED + 1):
        here = np.einsum("kij,nj->kni", poses[:, :3, :3], points) + poses[:, None, :3, 3]
        distance, which = tree.query(here.reshape(-1, 3))
        there = surface[which].reshape(here.shape)
        if step < TRIED:
            middles, ends = here.mean(1, keepdims=True), there.mean(1, keepdims=True)
            u, _, vt = np.linalg.svd(np.einsum("kni,knj->kij", there - ends, here - middles))
            u[..., -1] *= np.linalg.det(u @ vt)[:, None]
            turn = u @ vt
            shift = ends[:, 0] - np.einsum("kij,kj->ki", turn, middles[:, 0])
            poses = np.concatenate([turn @ poses[:, :3], poses[:, 3:]], 1)
            poses[:, :3, 3] += shift
    return poses[np.argsort(distance.reshape(len(poses), -1).mean(1))[:KEPT]]


def _turned(one: Fit, other: Fit) -> float:
    """Angle between two poses [deg]."""
    return float(np.rad2deg(pose.difference(one.matrix, other.matrix)[1]))


def _misfit(fit: Fit, samples: Samples, target: Target) -> float:
    """Mean distance of the nine tenths of the points that are nearest [m]."""
    found = target.nearest.planes(fit.moved(samples.points))
    distance = np.sort(np.minimum(np.abs(found.height) + 0.1 * found.distance, found.distance))
    return float(distance[: int(0.9 * len(distance))].mean())
