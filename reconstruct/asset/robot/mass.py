"""Mass, centre of gravity and inertia of a body of even density."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from koala3d.datasets.core.errors import UsageError

if TYPE_CHECKING:
    import trimesh

GRID = 96  # cells along the longest side, for the union of convex parts


@dataclass(frozen=True)
class Weight:
    """What is known of the object's mass: one of the two is None."""

    density: float | None
    """[kg/m3]"""
    mass: float | None
    """[kg]"""

    def __post_init__(self) -> None:
        if (self.density is None) == (self.mass is None):
            found = "neither was given" if self.mass is None else "both were given"
            remedy = "give --mass, in kg, of the weighed object, or --density, in kg/m3, of its material"
            raise UsageError("a robot's asset needs either a mass or a density", why=found, remedy=remedy)


@dataclass(frozen=True)
class Inertia:
    """Moments of a rigid body."""

    mass: float
    """[kg]"""
    volume: float
    """[m3]"""
    centre: Float[np.ndarray, "3"]
    """Centre of gravity [m]."""
    tensor: Float[np.ndarray, "3 3"]
    """About the centre of gravity, along the axes of the frame [kg m2]; products of inertia are negative sums, as in URDF."""
    measured_in: str
    """Which volume it was computed for."""

    def moved(self, offset: Float[np.ndarray, "3"]) -> "Inertia":
        """In a frame whose axes are parallel, after the body moved by `offset` [m]."""
        return replace(self, centre=self.centre + offset)


def inertia(surface: "trimesh.Trimesh", parts: "Sequence[trimesh.Trimesh]", weight: Weight) -> Inertia:
    """Moments of the volume inside a surface; of the union of its convex parts where the surface is not closed.

    Args:
        surface: [m].
        parts: of `convex_parts` of the surface.
        weight: a mass is spread evenly over the volume.
    """
    if surface.is_volume:
        volume, centre, tensor = float(surface.volume), surface.center_mass, surface.moment_inertia / surface.density
        measured_in = "the closed mesh"
    else:
        volume, centre, tensor = union_moments(parts)
        measured_in = f"the union of {len(parts)} convex parts, since the mesh is not closed"
    density = weight.density if weight.density is not None else float(weight.mass or 0) / volume
    return Inertia(density * volume, volume, np.asarray(centre), density * np.asarray(tensor), measured_in)


def union_moments(
    parts: "Sequence[trimesh.Trimesh]", grid: int = GRID
) -> tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Volume, centre, and inertia tensor about it at a density of 1, of what convex meshes cover together.

    Sums over the cells of a grid whose middle is in a part, so that overlaps count once.
    """
    from scipy.spatial import ConvexHull

    corners = np.concatenate([part.vertices for part in parts])
    low, high = corners.min(0), corners.max(0)
    cell = float((high - low).max()) / grid
    counts = np.maximum(np.ceil((high - low) / cell - 1e-6).astype(int), 1)
    axes = [a + cell * (np.arange(n) + 0.5) for a, n in zip((low + high - cell * counts) / 2, counts, strict=True)]
    covered = np.zeros(counts, bool)
    for part in parts:
        near = [np.flatnonzero((axis > a) & (axis < b)) for axis, a, b in zip(axes, *part.bounds, strict=True)]
        planes = ConvexHull(part.vertices).equations  # outside is positive
        y, z = np.meshgrid(axes[1][near[1]], axes[2][near[2]], indexing="ij")
        for column in near[0]:
            points = np.stack([np.full_like(y, axes[0][column]), y, z], -1)
            inside = (points @ planes[:, :3].T + planes[:, 3] <= 0).all(-1)
            covered[column, near[1][:, None], near[2]] |= inside
    points = np.stack([axis[place] for axis, place in zip(axes, np.nonzero(covered), strict=True)], -1)
    centre = points.mean(0)
    second = (points - centre).T @ (points - centre) + len(points) * cell**2 / 12 * np.eye(3)
    return len(points) * cell**3, centre, cell**3 * (np.trace(second) * np.eye(3) - second)
