"""Errors of the arm that repeat: how large they are, and what they do to the covariance of the rig.

An arm whose links differ from what its controller believes errs by the same law in every view. Such errors do not average out
as those of single stops do, and part of them looks exactly like another pose of the camera. The refinement takes all errors of
the arm as independent. Its answer is kept here; its covariance is computed anew.

Near the answer the correction of view i that the corners ask for is

    y[i] = K[i] u + c[i] + e[i] - T[i] g,

with the errors u that repeat, the error c[i] of the stop (deviations sigma_t, sigma_r), e[i] of the corners, and g of the global
unknowns. Where joint angles are known, u are the errors of the arm's Denavit-Hartenberg parameters, and K[i] moves the flange by
them. Elsewhere K u is a smooth random function of the flange's pose. All of u has one unknown `scale`.

For each scale the most likely sigmas are found with g and u integrated out (restricted likelihood; Patterson & Thompson 1971).
The answer is a weighted mean of all y, so its covariance follows from theirs. It is averaged over the scales by their likelihood.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from koala3d.calib.arrays import Array
from koala3d.calib.errors import Unobservable
from koala3d.calib.handeye import links
from koala3d.calib.handeye.refine import PRIOR_VIEWS, Problem, Refined, S, Sigmas, linear_system
from koala3d.datasets import kinematics

LENGTH_M, ANGLE_RAD = 5e-4, float(np.deg2rad(0.05))
"""Errors of lengths and angles of the links at a scale of one: those of an arm that was not measured after it was built."""
SCALES = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Scales that are tried, each as likely as the next before the views are seen."""
REACH_M, REACH_RAD = 0.3, 1.0
"""Motion over which the errors of an arm without joint angles stay alike: their correlation falls to exp(-1/2)."""
NEGLIGIBLE = 10.0  # a scale so much less likely than the best, by its logarithm, and all larger ones count for nothing
_LOOSE = 10.0  # deviation of an arm that says nothing [m, rad]
_RANK, _MODES = 0.01, 20  # smooth errors: smallest mode that is kept, as a share of the largest; and how many at most


class Posed(Problem[S], Protocol[S]):
    """A problem with what the arm reported at each view."""

    @property
    def base_from_flange(self) -> Array:
        """(views, 4, 4) [m]."""
        ...

    @property
    def joints(self) -> Array | None:
        """(views, joints) [rad], where they are known."""
        ...

    @property
    def links(self) -> kinematics.Links:
        """The arm's nominal chain."""
        ...

    @property
    def link_std(self) -> Array:
        """(4 n,) stated deviations of the links' errors that are estimated; 0 where none is."""
        ...


@dataclass(frozen=True)
class Repeating:
    """What the views say of the arm's errors, and the covariance that follows."""

    scale: float  # mean of the scale of the errors that repeat
    stop_m: float  # most likely deviation of each stop, per axis
    stop_rad: float
    covariance: Array  # (p, p) of the global unknowns

    def facts(self) -> dict[str, float]:
        """For the calibration file: the size of each kind of error."""
        return {
            "arm_stop_mm": 1e3 * self.stop_m,
            "arm_stop_deg": float(np.rad2deg(self.stop_rad)),
            "arm_links_mm": 1e3 * self.scale * LENGTH_M,
            "arm_links_deg": float(np.rad2deg(self.scale * ANGLE_RAD)),
        }


@dataclass(frozen=True)
class _Views:
    """The views as measurements of the flange's correction; p global unknowns, k errors that repeat."""

    asked: Array  # (views, 6) y
    by_global: Array  # (views, 6, p) T
    corners: Array  # (views, 6, 6) covariance of e
    repeating: Array  # (views, 6, k) K at a scale of one
    root: Array  # (p, p) what else is known of g: root @ g = side, with unit deviations
    side: Array  # (p,)
    stated: Sigmas

    def noise(self, stop: Array) -> Array:
        """(views, 6, 6) covariance of c + e for the (2,) deviations of a stop."""
        return self.corners + np.diag(np.repeat(stop**2, 3))

    def likelihood(self, stop: Array, scale: float) -> float:
        """Logarithm of the restricted likelihood, with what is stated of the arm."""
        lower = np.linalg.cholesky(self.noise(stop))
        rows = np.concatenate([self.by_global, -scale * self.repeating, self.asked[..., None]], -1)
        rows = (np.linalg.inv(lower) @ rows).reshape(-1, rows.shape[-1])
        unknowns, known = rows.shape[1] - 1, len(self.side)
        system = rows.T @ rows
        system[:known, :known] += self.root.T @ self.root
        system[:known, -1] += self.root.T @ self.side
        system[range(known, unknowns), range(known, unknowns)] += 1.0
        size = np.sqrt(np.diag(system)[:unknowns])
        triangle = np.linalg.cholesky(system[:unknowns, :unknowns] / np.outer(size, size))
        explained = solve_triangular(triangle, system[:unknowns, -1] / size, lower=True, check_finite=False)
        left = system[-1, -1] + self.side @ self.side - explained @ explained
        volume = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum() + np.log(np.diag(triangle)).sum() + np.log(size).sum()
        stated = np.array([self.stated.translation_m, self.stated.rotation_rad])
        prior = 3 * PRIOR_VIEWS * (np.log(stop / stated) + 0.5 * (stated / stop) ** 2).sum()
        return float(-0.5 * left - volume - prior)

    def most_likely_stop(self, scale: float, start: Array) -> tuple[Array, float]:
        """(2,) deviations of a stop [m], [rad] that explain the views best, and the logarithm of their likelihood.

        The search begins at `start` (2,).
        """
        options = {"xatol": 0.02, "fatol": 0.02, "maxiter": 80, "initial_simplex": [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]]}
        found = minimize(lambda x: -self.likelihood(start * np.exp(x), scale), [0.0, 0.0], method="Nelder-Mead", options=options)
        return start * np.exp(found.x), -float(found.fun)

    def covariance(self, assumed: Sigmas, stop: Array, scale: float) -> Array:
        """(p, p) covariance of the answer that takes the stops for `assumed` and errors that repeat for none."""
        weight = np.linalg.inv(self.noise(np.array([assumed.translation_m, assumed.rotation_rad])))
        weighted = weight @ self.by_global
        information = np.einsum("nip,niq->pq", self.by_global, weighted) + self.root.T @ self.root
        size = np.sqrt(np.diag(information))
        spread = np.einsum("nip,nij,njq->pq", weighted, self.noise(stop), weighted) + self.root.T @ self.root
        pull = scale * np.einsum("nip,nik->pk", weighted, self.repeating)
        inverse = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
        return np.asarray(inverse @ (spread + pull @ pull.T) @ inverse, np.float64)


def estimate(session: Posed[S], refined: Refined[S]) -> Repeating:
    """The arm's errors in the views of a refinement, and the covariance with errors that repeat.

    Raises Unobservable where the views leave something undetermined.
    """
    try:
        return _estimated(_views(session, refined), refined.sigmas)
    except np.linalg.LinAlgError:
        why, remedy = f"{len(refined.state.corrections)} views", "add views that are tilted by 20 degrees and more about two axes"
        raise Unobservable("errors of the arm and the hand-eye pose are not observable", why=why, remedy=remedy) from None


def _estimated(views: _Views, sigmas: Sigmas) -> Repeating:
    tried: list[tuple[float, Array, float]] = []
    stop = np.array([sigmas.translation_m, sigmas.rotation_rad])
    for scale in SCALES if views.repeating.any() else SCALES[:1]:
        stop, likelihood = views.most_likely_stop(scale, stop)
        tried.append((scale, stop, likelihood))
        if likelihood < max(value for _, _, value in tried) - NEGLIGIBLE:
            break
    share = np.exp(np.array([value for _, _, value in tried]) - max(value for _, _, value in tried))
    share /= share.sum()
    covariance = sum(part * views.covariance(sigmas, stop, scale) for part, (scale, stop, _) in zip(share, tried, strict=True))
    _, stop, _ = tried[int(share.argmax())]
    mean = float(share @ np.array([scale for scale, _, _ in tried]))
    return Repeating(mean, float(stop[0]), float(stop[1]), np.asarray(covariance))


def _views(session: Posed[S], refined: Refined[S]) -> _Views:
    """The views of a refinement about its answer."""
    loose = Sigmas(refined.sigmas.pixel, _LOOSE, _LOOSE, refined.sigmas.width)
    system = linear_system(session.some(refined.inliers), refined.state, loose)
    inverse = np.linalg.inv(system.own)
    asked = refined.state.corrections + (inverse @ system.own_side[..., None])[..., 0]
    stated = Sigmas(refined.sigmas.pixel, session.accuracy.translation_m, session.accuracy.rotation_rad)
    spread = inverse @ np.swapaxes(inverse, 1, 2)
    return _Views(asked, inverse @ system.coupling, spread, _in_few(motions(session)), system.root, system.side, stated)


def _in_few(motions: Array) -> Array:
    """`motions` (views, 6, k) with the same covariance, made of at most as many errors as there are numbers."""
    views, axes, count = motions.shape
    if count <= views * axes:
        return motions
    return np.asarray(np.linalg.qr(motions.reshape(-1, count).T, mode="r")).T.reshape(views, axes, -1)


def motions(session: Posed[Any]) -> Array:
    """(views, 6, k) motion of the flange in its own axes [m, rad] for each of the errors that repeat, at a scale of one."""
    if session.joints is None or not links.are_those_of_the_poses(session.joints, session.base_from_flange, session.links):
        return _smooth(session.base_from_flange)
    sizes = np.repeat([LENGTH_M, LENGTH_M, ANGLE_RAD, ANGLE_RAD], session.links.count)
    estimated = session.link_std.reshape(4, -1).any(1)  # by kind: what the two poses absorb is zero by convention then
    sizes[np.repeat(estimated, session.links.count)] = 0.0
    return np.asarray(kinematics.link_motions(session.joints, session.links) * sizes, np.float64)


def _smooth(base_from_flange: Array) -> Array:
    """`motions` of an arm whose joint angles are not known: modes of a smooth random function of (views, 4, 4) poses.

    Half of its variance is smooth in the flange's axes, half in those of the base.
    """
    turns, places = base_from_flange[:, :3, :3], base_from_flange[:, :3, 3]
    features = np.concatenate([places / REACH_M, turns.reshape(-1, 9) / (np.sqrt(2) * REACH_RAD)], -1)
    apart2 = ((features[:, None] - features) ** 2).sum(-1)
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart2))
    kept = (values > _RANK * values[-1]) & (np.arange(len(values)) >= len(values) - _MODES)
    modes = vectors[:, kept] * np.sqrt(values[kept] / 2)  # (views, modes)
    sizes = np.diag(np.repeat([LENGTH_M, ANGLE_RAD], 3))
    in_flange = np.einsum("nm,ij->nimj", modes, sizes).reshape(len(modes), 6, -1)
    twice = np.zeros((len(modes), 6, 6))
    twice[:, :3, :3] = twice[:, 3:, 3:] = np.swapaxes(turns, 1, 2)
    return np.concatenate([in_flange, twice @ in_flange], -1)
