"""Distances of matches from the epipolar planes of their cameras, and small corrections of cameras that reduce them.

The distance of a match is that of its pixels from each other's epipolar lines, to first order (Sampson 1982) and as a distance
along one picture [px]. It needs no depth. Robust Gauss-Newton with weights after Geman and McClure, whose width shrinks from
round to round, as in graduated non-convexity (Yang et al. 2020), so that corrections of up to about the first width are found
among wrong matches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.structure.matching import Matches

Vector = NDArray[np.float64]

WIDTHS = (16.0, 8.0, 4.0, 2.0, 1.0, 1.0)
"""Residuals beyond which a match counts little, round by round [px]."""
CLOSE = (0.6,) * 6
"""Widths that may follow where right matches are known to lie nearer: wrong ones a pixel or two away then pull no more [px]."""
INLIER_PX = 3.0
"""Matches nearer than this after the correction are right ones."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """All matches in one row each."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    """(m,) indices of views."""
    a: Vector
    b: Vector
    """(m, 3) rays in the cameras' frames, z = 1."""
    pixel: Vector
    """(m,) size of a pixel as a tangent."""

    @classmethod
    def of(cls, matches: Matches) -> "Pairs":
        """The matches of all pairs."""
        columns: list[list[NDArray]] = [[], [], [], [], []]
        for i, j, index in matches.pairs:
            one, other, n = matches.features[i], matches.features[j], len(index)
            pixel = np.full(n, max(one.pixel, other.pixel))
            row = np.full(n, i), np.full(n, j), one.directions[index[:, 0]], other.directions[index[:, 1]], pixel
            for column, part in zip(columns, row, strict=True):
                column.append(part)
        return cls(*(np.concatenate(column) for column in columns))

    def of_view(self, view: int) -> "Pairs":
        """The matches of one view."""
        return self.at(np.flatnonzero((self.first == view) | (self.second == view)))

    def at(self, rows: NDArray[np.intp]) -> "Pairs":
        """Some of the matches."""
        return Pairs(self.first[rows], self.second[rows], self.a[rows], self.b[rows], self.pixel[rows])

    @cached_property
    def _of_two(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(2, p) the pairs of views, and (m,) which of them each match is of."""
        count = 1 + self.second.max(initial=0)
        codes, which = np.unique(self.first * count + self.second, return_inverse=True)
        return np.stack(np.divmod(codes, count)), which

    def essential(self, world_from_camera: Vector) -> Vector:
        """(3, 3, m) essential matrix E of each match, b . E a = 0 where its rays meet; (views, 4, 4) poses."""
        pairs, which = self._of_two
        one, other = world_from_camera[pairs]
        normals = np.cross(other[:, :3, 3, None] - one[:, :3, 3, None], one[:, :3, :3], axis=1)
        return np.moveaxis(np.swapaxes(other[:, :3, :3], 1, 2) @ normals, 0, -1)[..., which]

    def distances(self, world_from_camera: Vector) -> Vector:
        """(m,) signed distance from the epipolar plane [px]; (views, 4, 4) poses."""
        return off_plane(self.essential(world_from_camera), self.a, self.b) / self.pixel


def off_plane(essential: Vector, a: Vector, b: Vector) -> Vector:
    """(m,) signed distance of (m, 3) rays a, b with z = 1 from the plane of their (3, 3, m) essential matrix, as a tangent."""
    a, b = np.ascontiguousarray(a.T), np.ascontiguousarray(b.T)
    in_second, in_first = np.einsum("ijn,jn->in", essential, a), np.einsum("ijn,in->jn", essential, b)  # epipolar lines
    slope = np.sqrt(((in_second[:2] ** 2).sum(0) + (in_first[:2] ** 2).sum(0)) / 2)
    return (in_second * b).sum(0) / np.maximum(slope, 1e-300)


@dataclass(frozen=True, eq=False)
class Correction:
    """A small change of parameters that makes matches agree better."""

    change: Vector
    std: Vector
    before_px: float
    after_px: float
    """Median distance of the right matches, before and after."""
    inliers: int
    gain: float
    """Share of the robust cost that the change removes; negative where the last width finds that it helps nothing."""


def corrected(
    distances: Callable[[Vector], Vector], steps: Sequence[float], *, damping: float = 1e-3, widths: Sequence[float] = WIDTHS
) -> Correction:
    """The change of k parameters from zero that reduces robust distances.

    Args:
        distances: (k,) change to (m,) distances [px].
        steps: change of each parameter that moves pixels by about one; for derivatives, and the scale of damping.
        damping: towards no change, in matches per parameter; keeps what no match fixes.
        widths: residuals beyond which a match counts little, round by round [px].
    """
    scale, change = np.asarray(steps, np.float64), np.zeros(len(steps))
    start = residual = distances(change)
    normal = np.eye(len(steps))
    for width in widths:
        weight = 1 / (1 + (residual / width) ** 2) ** 2
        slope = [(distances(change + step) - distances(change - step)) / 0.2 for step in 0.1 * np.diag(scale)]
        slope = np.stack(slope, axis=1)  # per step
        normal = slope.T @ (weight[:, None] * slope) + damping * max(weight.sum(), 1.0) * np.eye(len(steps))
        change = change - scale * np.linalg.solve(normal, slope.T @ (weight * residual))
        residual = distances(change)
    inlier = np.abs(residual) < INLIER_PX
    if not inlier.any():
        return Correction(np.zeros(len(steps)), np.full(len(steps), np.inf), np.inf, np.inf, 0, 0.0)
    before, after = (float(np.median(np.abs(values[inlier]))) for values in (start, residual))
    std = scale * np.sqrt(np.diag(np.linalg.inv(normal))) * max(1.4826 * after, 1e-3)
    gain = 1 - cost(residual, widths[-1]) / max(cost(start, widths[-1]), 1e-12)
    return Correction(change, std, before, after, int(inlier.sum()), gain)


def cost(distances: Vector, width: float) -> float:
    """The sum of Geman and McClure's loss: what a match adds grows from 0 to 1, and is a half at `width` [px]."""
    return float((distances**2 / (distances**2 + width**2)).sum())
