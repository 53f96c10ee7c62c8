"""The surface of an object as places: points with normals, each for a share of the area."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Places:
    """A surface in the base frame [m]."""

    points: Array
    """(n, 3)."""
    normals: Array
    """(n, 3) unit, outwards."""
    shares: Array
    """(n,) share of the area, with the sum 1."""
    spacing: float
    """Typical distance between neighbours [m]."""

    @classmethod
    def of(cls, points: Array, normals: Array, areas: Array, spacing: float) -> "Places":
        """Places with (n,) areas in any unit."""
        return cls(points, normals, areas / areas.sum(), spacing)


def of_box(corners: Array, up: int, spacing: float = 0.01) -> Places:
    """The sides and the top of the box between (2, 3) corners [m]; `up` is the sign of the base's z axis upwards."""
    low, high = corners
    size, found = high - low, []
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        counts = np.maximum(np.round(size[across] / spacing), 1).astype(int)
        steps = [low[other] + size[other] * (np.arange(n) + 0.5) / n for other, n in zip(across, counts, strict=True)]
        for side in (-1, 1):
            if axis == 2 and side != up:
                continue  # it stands on this one
            points = np.empty((counts.prod(), 3))
            points[:, across] = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 2)
            points[:, axis] = high[axis] if side > 0 else low[axis]
            normals = np.zeros_like(points)
            normals[:, axis] = side
            found.append((points, normals, np.full(len(points), size[across].prod() / len(points))))
    points, normals, areas = (np.concatenate(part) for part in zip(*found, strict=True))
    return Places.of(points, normals, areas, spacing)


def of_cells(inside: NDArray[np.bool_], low: Array, cell: Array) -> Places:
    """The surface of the cells that are (nx, ny, nz) `inside` of a grid that begins at the (3,) corner `low` [m].

    Normals are those of the smoothed occupancy. A cell's area is that of its open faces divided by how much larger the faces of
    a staircase are than the plane that it follows.

    Args:
        cell: (3,) size of a cell [m].
    """
    from scipy.ndimage import gaussian_filter

    padded = np.pad(inside, 2)
    smooth = gaussian_filter(padded.astype(np.float64), 1.2)
    slopes = np.stack([np.gradient(smooth, axis=axis) for axis in range(3)], -1) / cell
    area = np.zeros(padded.shape)
    for axis in range(3):
        face = float(np.delete(cell, axis).prod())
        for step in (-1, 1):
            area += face * (padded & ~np.roll(padded, step, axis))
    at = np.argwhere(area > 0)
    slope = slopes[tuple(at.T)]
    length = np.linalg.norm(slope, axis=1)
    at, slope = at[length > 0], slope[length > 0] / length[length > 0, None]
    normals = -slope
    points = low + (at - 2 + 0.5) * cell + 0.5 * normals * cell  # from the cell's middle to its rim
    return Places.of(points, normals, area[tuple(at.T)] / np.abs(normals).sum(1), float(cell.mean()))


def of_mesh(vertices: Array, faces: NDArray[np.int64], count: int, seed: int = 0) -> Places:
    """`count` places that are even over the area of a mesh with (v, 3) vertices [m] and (f, 3) faces."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(cross, axis=1)
    rng = np.random.default_rng([seed, 41])
    below = np.cumsum(doubled)
    at = np.searchsorted(below, (np.arange(count) + rng.uniform(size=count)) / count * below[-1])
    at = np.minimum(at, len(faces) - 1)
    u, v = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    weights = np.stack([1 - u, u * (1 - v), u * v], -1)
    points = np.einsum("nk,nkd->nd", weights, corners[at])
    normals = cross[at] / np.maximum(doubled[at, None], 1e-300)
    return Places.of(points, normals, np.ones(count), float(np.sqrt(below[-1] / 2 / count)))
