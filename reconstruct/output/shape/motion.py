"""Iterated closest points: from where two surfaces are to where they fit best.

Points of one surface are moved by a rotation, a translation and, on request, a scale s so that the distances to the tangent
planes of their closest points on the other become small (Chen and Medioni 1992). Far points count less, and beyond a few times
the usual distance nothing (Tukey's biweight): a dent, or what only one of them has, does not pull. Where errors are stated, the
better known pulls more, and what is not known not at all.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from koala3d.reconstruct.output.mesh.nearest import Nearest

STEPS, ENOUGH = 60, 1e-6
"""Most steps, and the motion, in sizes of the surface, below which there is no other."""
WIDTH = 4.685
"""Of Tukey's biweight, in robust standard deviations: 95 % efficient where all errors are normal (Huber 1981)."""
FAR = 0.02
"""Distance, in sizes of the surface, from which it counts as it is, not across the tangent plane alone."""
SAME_WAY = 0.2
"""Least cosine between the normals of points that correspond."""
UNSTATED = 0.25
"""Share of the square of the usual distance that is added to stated variances: of errors that nobody states."""
DAMPING = 1e-4
"""Share of the mean information that is added: a ball may turn without any point coming closer, and does not."""
GROUPS = 24
"""Patches of which one at a time is left out to find how certain a fit is: errors agree within a patch."""


@dataclass(frozen=True)
class Fit:
    """One surface placed on another."""

    matrix: Float[np.ndarray, "4 4"]
    """Moves points of the first onto the second: x -> matrix x, with its scale."""
    scale: float
    """Size of the first surface relative to the second, so the matrix scales by 1 / scale."""
    usual: float
    """Robust standard deviation of the distances that are left [m]."""
    middle: Float[np.ndarray, " 3"]
    """Of the first surface, where it lies on the second."""
    covariance: Float[np.ndarray, "k k"]
    """Of the error: a shift of `middle` [m], a turn about it [rad] and, if it was fitted, the logarithm of the scale. From how
    much patches of the surface disagree."""

    @property
    def scale_std(self) -> float:
        """Relative standard deviation; 0 where no scale was fitted."""
        return float(np.sqrt(self.covariance[6, 6])) if len(self.covariance) > 6 else 0.0

    def moved(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the first surface on the second."""
        return points @ self.matrix[:3, :3].T + self.matrix[:3, 3]

    def motion(self, centre: Float[np.ndarray, " 3"]) -> tuple[float, float]:
        """How far a point is moved [m], and by which angle everything is turned [deg]."""
        turn = Rotation.from_matrix(self.matrix[:3, :3] * self.scale)
        return float(np.linalg.norm(self.moved(centre[None])[0] - centre)), float(np.rad2deg(turn.magnitude()))


@dataclass(frozen=True)
class Samples:
    """Points of a surface with outward unit normals."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    variance: Float[np.ndarray, " n"]
    """Of the place along the normal, as stated [m^2]; infinite where nothing is known."""

    def some(self, count: int) -> "Samples":
        """The first `count`: they are in random order."""
        return Samples(self.points[:count], self.normals[:count], self.variance[:count])


@dataclass(frozen=True)
class Target:
    """A surface on which others are placed."""

    nearest: Nearest
    variance: Float[np.ndarray, " f"]
    """Of each triangle, as in `Samples`."""


def closest(
    samples: Samples, target: Target, start: Float[np.ndarray, "4 4"], *, scaled: bool = False, steps: int = STEPS
) -> Fit:
    """Fit that begins at `start`, a rigid motion or a similarity."""
    matrix, size = np.asarray(start, np.float64).copy(), float(np.linalg.norm(np.ptp(samples.points, axis=0)))
    for _ in range(steps):
        rotation, scale = _parts(matrix)
        here = samples.points @ matrix[:3, :3].T + matrix[:3, 3]
        found = target.nearest.planes(here)
        unsure = samples.variance + target.variance[found.triangles]
        fits = (np.sum((samples.normals @ rotation.T) * found.normals, -1) > SAME_WAY) & ~found.at_an_edge & np.isfinite(unsure)
        middle = here.mean(0)
        if fits.sum() < 20:
            return Fit(matrix, 1 / scale, np.inf, middle, np.full((6, 6), np.inf))
        apart = np.where(found.distance < FAR * size, np.abs(found.height), found.distance)
        usual = 1.4826 * float(np.median(apart[fits]))
        share = np.minimum(apart / max(WIDTH * usual, 1e-9 * size), 1)
        known = 1 / (UNSTATED + unsure / max(usual, 1e-9 * size) ** 2)
        weights, across = np.where(fits, known * (1 - share**2) ** 2, 0.0), found.normals
        arm = (here - middle) / size
        columns = np.concatenate([across, np.cross(arm, across), np.sum(arm * across, -1, keepdims=True)], -1)
        if not scaled:
            columns = columns[:, :6]
        step = _solved(columns, found.height / size, weights)
        matrix = _applied(step, middle, size) @ matrix
        if np.abs(step).max() < ENOUGH:
            break
    lengths = np.array([size] * 3 + [1.0] * (columns.shape[1] - 3))
    covariance = _covariance(columns, found.height / size, weights, samples.points) * lengths[:, None] * lengths
    return Fit(matrix, 1 / _parts(matrix)[1], usual, middle, covariance)


def _parts(matrix: Float[np.ndarray, "4 4"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Rotation and scale of a similarity."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return matrix[:3, :3] / scale, scale


def _applied(step: Float[np.ndarray, " k"], middle: Float[np.ndarray, " 3"], size: float) -> Float[np.ndarray, "4 4"]:
    """The motion of a step: turned and scaled about the middle, then moved."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec(step[3:6]).as_matrix() * (np.exp(step[6]) if len(step) > 6 else 1.0)
    found[:3, 3] = middle + size * step[:3] - found[:3, :3] @ middle
    return found


def _solved(
    columns: Float[np.ndarray, "n k"], left: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " k"]:
    """The step after which the weighted squares of what is left are least."""
    pull = columns.T * weights
    information = pull @ columns
    damping = DAMPING * np.trace(information) / len(information) + 1e-30
    return np.linalg.solve(information + damping * np.eye(len(information)), -pull @ left)


def _covariance(
    columns: Float[np.ndarray, "n k"], left: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"], points: np.ndarray
) -> Float[np.ndarray, "k k"]:
    """Of the step that is solved for: the delete-a-group jackknife (Shao and Tu 1995, section 2.3)."""
    group = _groups(points)
    found = [_solved(columns[group != one], left[group != one], weights[group != one]) for one in range(GROUPS)]
    return (GROUPS - 1) * np.cov(np.array(found).T, bias=True)


def _groups(points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Patches of points: each belongs to the nearest of `GROUPS` of them that are far from each other."""
    chosen, distance = [0], np.full(len(points), np.inf)
    while len(chosen) < GROUPS:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=-1))
        chosen.append(int(distance.argmax()))
    return np.linalg.norm(points[:, None] - points[chosen], axis=-1).argmin(1)
