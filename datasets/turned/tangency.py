"""How well outlines of two sessions agree on a motion of the object: planes through two cameras that touch it in one do in both.

A plane through the centres of two cameras is seen as a line by both. If it touches the object, its line touches both outlines
(the epipolar tangency constraint: Porrill and Pollard 1991; for sets of silhouettes Forbes, Nicolls, de Jager and Voigt 2006).
Each pair of a view of one session and a view of the other has two such planes, one on either side: their angles about the line
through the cameras, as either outline tells them, must be the same. Times the object's distance from that line the difference
is a length. Only the convex hull counts. A border that masks move outwards or inwards everywhere moves both angles, the more the
farther the camera is: by how many pixels is found along with the motion, since masks of both sessions err alike and see opposite
sides of the object from nearby. Near what the object stands on, a mask that was found in a picture is of its shadow as well.
Planes that touch an outline there count only if asked for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.turned.outlines import Outlines

Array = NDArray[np.float64]
ASIDE = 0.05
"""A ray leaves the line through the cameras by an angle of this sine at least; else the object is on the line."""
AWAY = 0.2
"""Distance of the object's middle from that line, in radii of the object, from which a pair is used."""
FEWEST_PLANES = 0.05
"""Share of the planes that must count."""
CLIPPED = 8.0
"""Differences count as so many pixels at most: a mask may be wrong altogether, and a handle is seen by few pairs."""
OUTLIER = 2.0
"""Differences of so many standard deviations count half (the weights of Cauchy's distribution)."""
LONGEST = 0.3
"""Largest turn of one step [rad]: angles of tangents bend beyond."""
SIDES = 60
"""Directions, evenly spread, by which places of the object are told apart: 30 degrees from one to the next."""
BORDER = 2.0
"""Standard deviation of how far all masks are too large or too small [px], before anything is known of it."""
OUTWARDS = np.array([1.0, -1.0])
"""Sign by which the angles of the two planes grow where outlines move outwards."""
STEPS = np.array([1e-5] * 3 + [1e-4] * 3)
"""For differences: lengths in radii of the object, and turns [rad]."""
MAD = 1.4826
"""Standard deviation by the median of absolute values, of the normal distribution."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A motion and how well the outlines agree on it."""

    a_from_b: Array
    """(4, 4)."""
    misfit: float
    """Root mean square of the differences, each clipped at `CLIPPED` pixels [pixel]; infinite where too few can be compared."""
    border: float
    """How far the masks' borders are outside the object's [pixel]."""


@dataclass(frozen=True, eq=False)
class Planes:
    """For (n, m) pairs of cameras and one or several motions: directions about the line through both, in the world of a."""

    out: Array
    """(..., n, m, 3) unit vectors from the line to the object's middle."""
    up: Array
    """(..., n, m, 3) unit vectors across the line and `out`."""
    away: Array
    """(..., n, m) distance of the object's middle from the line [world unit]."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """All pairs of a view of session a and a view of session b."""

    a: Outlines
    b: Outlines
    low: bool = False
    """Whether planes count that touch an outline near what the object stands on."""

    def _planes(self, a_from_b: Array) -> Planes:
        centres = self.b.centres @ np.swapaxes(a_from_b[..., :3, :3], -1, -2) + a_from_b[..., None, :3, 3]
        line = centres[..., None, :, :] - self.a.centres[:, None]
        line = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), 1e-12)
        out = self.a.middle - self.a.centres[:, None]
        out = out - np.sum(out * line, -1, keepdims=True) * line
        away = np.linalg.norm(out, axis=-1)
        out = out / np.maximum(away, 1e-12)[..., None]
        return Planes(out, np.cross(line, out), away)

    def _touching(self, a_from_b: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """(n, m, 2, 3) rays of a, and of b in its own world, in the planes that touch; and (n, m, 2) which planes count."""
        planes = self._planes(a_from_b)
        of_a, good = self._extremes(self.a, planes.out, planes.up)
        back = a_from_b[:3, :3]
        of_b, other = self._extremes(self.b, np.swapaxes(planes.out @ back, 0, 1), np.swapaxes(planes.up @ back, 0, 1))
        aside = planes.away > AWAY * self.a.extent
        return of_a, np.swapaxes(of_b, 0, 1), good & np.swapaxes(other, 0, 1) & aside[..., None]

    def _extremes(self, outlines: Outlines, out: Array, up: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(n, m, 2, 3) rays of outlines at the largest and the smallest angle from (n, m, 3) `out` towards `up`, and whether they
        count: all rays of the view are on the side of `out`, where tangents rise with angles, and this one is not low."""
        columns = np.swapaxes(outlines.rays, 1, 2)
        along = out @ columns
        tangents = up @ columns / np.maximum(along, 1e-12)
        which = np.stack([tangents.argmax(-1), tangents.argmin(-1)], -1)
        view = np.arange(len(outlines.rays))[:, None, None]
        return outlines.rays[view, which], (along.min(-1) > ASIDE)[..., None] & (self.low | ~outlines.low[view, which])

    def _differences(self, a_from_b: Array, of_a: Array, of_b: Array) -> tuple[Array, Array]:
        """(..., n, m, 2) differences [world unit] by (..., 4, 4) motions, of the planes of rays from `_touching`; and what a
        border that is a pixel too far out adds to them."""
        planes = self._planes(a_from_b)
        of_b = of_b @ np.swapaxes(a_from_b[..., None, None, :3, :3], -1, -2)
        angles, borders = [], []
        for rays, pixel in ((of_a, self.a.pixel_angle), (of_b, self.b.pixel_angle)):
            up, out = (np.sum(rays * axis[..., None, :], -1) for axis in (planes.up, planes.out))
            angles.append(np.arctan2(up, out))
            borders.append(OUTWARDS * pixel / np.maximum(np.hypot(up, out), ASIDE))  # the nearer to the line the more
        away = planes.away[..., None]
        return (angles[0] - angles[1]) * away, (borders[0] - borders[1]) * away

    def differences(self, a_from_b: Array, border: float = 0.0) -> Array:
        """(k,) differences of the tangent planes that both cameras of a pair tell, without what the border adds [world unit]."""
        of_a, of_b, usable = self._touching(a_from_b)
        found, added = self._differences(a_from_b, of_a, of_b)
        return (found - border * added)[usable].ravel()

    def moved(self, a_from_b: Array, by: Array) -> Array:
        """The motion and then a small one, or several: (..., 6) a shift, and a turn about the middle of a."""
        turn = Rotation.from_rotvec(by[..., 3:]).as_matrix()
        place = turn @ (a_from_b[:3, 3] - self.a.middle) + self.a.middle + by[..., :3]
        return pose.rigid(turn @ a_from_b[:3, :3], place)

    def linear(self, a_from_b: Array, border: float) -> tuple[Array, Array, Array]:
        """(n, m, 2) differences, their weights and their (n, m, 2, 7) derivatives, by the six numbers of `moved` and the border.

        Which rays touch changes from motion to motion, but the derivatives are as if it did not: an angle is extreme at them.
        """
        of_a, of_b, usable = self._touching(a_from_b)
        plain, added = self._differences(a_from_b, of_a, of_b)
        ahead = self.moved(a_from_b, np.diag(self._steps))
        slopes = np.moveaxis(self._differences(ahead, of_a, of_b)[0] - plain, 0, -1) / self._steps
        found = plain - border * added
        scale = OUTLIER * max(spread(found[usable].ravel()), 1e-9 * self.a.extent)
        return found, usable / (1 + (found / scale) ** 2), np.concatenate([slopes, -added[..., None]], -1)

    def _normal(self, weights: Array, slopes: Array, found: Array) -> Array:
        """(7, 7) normal equations, with what is known of the border."""
        known = np.zeros((7, 7))
        known[6, 6] = (spread(found[weights > 0]) / BORDER) ** 2 if (weights > 0).any() else 1.0
        return np.einsum("nms,nmsk,nmsl->kl", weights, slopes, slopes, optimize=True) + known

    @property
    def _steps(self) -> Array:
        return STEPS * np.array([self.a.extent] * 3 + [1.0] * 3)

    def refined(self, a_from_b: Array, most: int) -> Fit:
        """The motion on which the outlines agree best, from one nearby, by at most so many steps of Gauss and Newton."""
        border = 0.0
        for _ in range(most):
            found, weights, slopes = self.linear(a_from_b, border)
            normal = self._normal(weights, slopes, found)
            pull = np.einsum("nms,nmsk,nms->k", weights, slopes, found, optimize=True)
            by = -np.linalg.lstsq(normal + 1e-6 * np.diag(np.diag(normal)), pull, rcond=1e-12)[0]
            by *= min(1.0, LONGEST / max(float(np.linalg.norm(by[3:6])), 1e-12))
            a_from_b, border = self.moved(a_from_b, by[:6]), float(np.clip(border + by[6], -CLIPPED, CLIPPED))
            if (np.abs(by[:6]) < 0.1 * self._steps).all():
                break
        return Fit(a_from_b, self.misfit(a_from_b, border), border)

    def misfit(self, a_from_b: Array, border: float = 0.0) -> float:
        """See `Fit`."""
        found = self.differences(a_from_b, border) / self.a.pixel
        if found.size < FEWEST_PLANES * 2 * len(self.a.centres) * len(self.b.centres):
            return np.inf
        return float(np.sqrt(np.mean(np.minimum(np.abs(found), CLIPPED) ** 2)))

    def covariance(self, fit: Fit) -> Array:
        """(6, 6) of the error of a refined motion, as `moved` takes it: shift [world unit^2], then turn.

        What pulls has weights, which fall as a difference grows; the motion gives way by their slope, which falls faster (Huber
        1964). And it is not pairs that err by themselves. A mask that is wrong pulls all pairs of its view; and an outline is
        seen too far out where the object is flat and less so where it has an edge, alike by all pairs that touch it there. So it
        is the sum, over the views of both sessions and over `SIDES` of the object, of the square of what each of them pulls
        (clustered in three ways: Cameron, Gelbach and Miller 2011, without the parts that they subtract).
        """
        found, weights, slopes = self.linear(fit.a_from_b, fit.border)
        normal = self._normal(2 * weights**2 - weights, slopes, found)
        if not np.linalg.eigvalsh(normal)[0] > 0:
            return np.diag(np.full(6, np.inf))
        pulls = (weights * found)[..., None] * slopes
        sides = np.argmax(self.normals(fit.a_from_b) @ pose.directions(SIDES).T, -1)
        by_side = np.stack([np.bincount(sides.ravel(), pull, SIDES) for pull in pulls.reshape(-1, 7).T], -1)
        groups = pulls.sum((1, 2)), pulls.sum((0, 2)), by_side[np.any(by_side != 0, -1)]
        by = [np.linalg.solve(normal, group.T)[:6] for group in groups]
        return sum((one @ one.T * one.shape[1] / max(one.shape[1] - 7, 1) for one in by), np.zeros((6, 6)))

    def normals(self, a_from_b: Array) -> Array:
        """(n, m, 2, 3) outward unit normals, in the world of a, of the planes that touch."""
        planes, of_a = self._planes(a_from_b), self._touching(a_from_b)[0]
        up, out = planes.up[..., None, :], planes.out[..., None, :]
        across = np.sum(of_a * out, -1, keepdims=True) * up - np.sum(of_a * up, -1, keepdims=True) * out
        return across / np.linalg.norm(across, axis=-1, keepdims=True) * np.array([[1.0], [-1.0]])


def spread(values: Array) -> float:
    """Robust standard deviation of values about zero; infinite of none."""
    return MAD * float(np.median(np.abs(values))) if values.size else np.inf
