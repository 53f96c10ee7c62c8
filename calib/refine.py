"""The most likely rig: everything unknown in a target session, refined together on what the pictures show.

With the predictions and the corrections C[i] of `calib.model`, minimised is

    sum huber(|seen - predicted| / sigma_px)  +  sum |translation(C[i]) / sigma_t|^2 + |rotation(C[i]) / sigma_r|^2
    + what is known of the intrinsics beforehand,

by Levenberg-Marquardt with analytic derivatives. A view's correction touches its own corners alone, so the normal
equations are solved by eliminating the (6, 6) blocks of the views (Schur complement; Triggs et al. 2000, section 6.1).
The three sigmas are estimated along with the rest (MacKay 1992, eq. 4.9): sigma_px from the residuals alone, sigma_t and sigma_r
starting from the arm's stated accuracy, which counts as `PRIOR_VIEWS` views' worth of evidence.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from calib import projection
from calib.errors import CalibrationError
from calib.model import Session, State, perturbed, predict

Array = NDArray[np.float64]
HUBER = 3.0
"""Residual in sigmas from which on a corner pulls with constant force; a good one gets there once in 90 times."""
OUTLIER = 6.0
"""Residual in sigmas from which on a corner is left out."""
PRIOR_VIEWS = 4.0
"""How many views' worth of evidence the arm's stated accuracy is."""


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of the three kinds of error, per axis."""

    pixel: float
    translation_m: float
    rotation_rad: float

    @property
    def correction(self) -> Array:
        """(6,) of a view's correction."""
        return np.repeat([self.translation_m, self.rotation_rad], 3)


@dataclass(frozen=True)
class Refined:
    """The answer and its verdict."""

    state: State
    sigmas: Sigmas
    """As estimated."""
    information: Array
    """(p, p) of the global parameters, the corrections eliminated: its inverse is their covariance."""
    residuals: Array
    """(n, 2) seen minus predicted, outliers too [px]."""
    inliers: NDArray[np.bool_]
    """(n,) corners that took part."""
    steps: int
    """Accepted steps in all."""
    settled: bool
    """Whether sigmas and outliers stopped changing; if not, the answer may still move."""

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the corners that took part [px]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals[self.inliers] ** 2, -1))))


def refine(session: Session, start: State, *, sigma_px: float, rounds: int = 12) -> Refined:
    """Minimise from `start`; `sigma_px` is a first guess of a corner's standard deviation per axis [px].

    Raises:
        CalibrationError: the start is too far off, or nearly all corners are outliers.
    """
    sigmas = Sigmas(sigma_px, session.accuracy.translation_m, session.accuracy.rotation_rad)
    state, steps, settled = start, 0, False
    inliers = np.ones(len(session.view), bool)
    for number in range(rounds):
        chosen = session.some(inliers)
        state, count = _minimise(chosen, state, sigmas)
        steps += count
        residuals = session.pixels - predict(session, state)[0]
        system = _system(chosen, state, sigmas)
        last, sigmas = sigmas, _estimated_sigmas(chosen, state, sigmas, system, residuals[inliers])
        kept = np.linalg.norm(residuals, axis=1) <= OUTLIER * max(sigmas.pixel, 1e-6)
        if kept.sum() < 0.5 * len(kept):
            raise CalibrationError("pictures and arm poses do not fit together", why=f"{(~kept).sum()} of {len(kept)} corners are outliers",
                                   remedy="check that poses are flange poses in metres and belong to these images")  # fmt: skip
        ratios = np.log([sigmas.pixel / last.pixel, *(sigmas.correction[[0, 3]] / last.correction[[0, 3]])])
        settled = number > 0 and bool((kept == inliers).all() and np.abs(ratios).max() < 0.01)
        inliers = kept
        if settled:
            break
    information, *_ = _reduced(_system(session.some(inliers), state, sigmas))
    return Refined(state, sigmas, information, residuals, inliers, steps, settled)


def fit_board(session: Session, state: State, max_steps: int = 30) -> State:
    """`state` with the board where the corners want it, all else kept: Gauss-Newton with Huber's weights."""
    for _ in range(max_steps):
        pixels, by_global, _ = predict(session, state)
        residuals = session.pixels - pixels
        distance = np.linalg.norm(residuals, axis=1)
        sigma = max(np.median(distance) / 1.1774, 1e-9)  # the median of a length in two dimensions is 1.1774 sigma
        root = np.sqrt(np.minimum(1.0, HUBER * sigma / np.maximum(distance, 1e-12)))[:, None]
        rows = (by_global[..., -6:] * root[..., None]).reshape(-1, 6)
        step = np.linalg.lstsq(rows, (residuals * root).ravel(), rcond=None)[0]
        state = replace(state, base_from_board=perturbed(state.base_from_board, step))
        if np.abs(step).max() < 1e-9:
            break
    return state


@dataclass(frozen=True)
class _System:
    """Normal equations in blocks: global g, views v."""

    gg: Array
    gv: Array
    vv: Array
    g: Array
    v: Array
    cost: float


def _system(session: Session, state: State, sigmas: Sigmas) -> _System:
    """Normal equations at `state` with Huber's weights; right-hand sides point downhill."""
    pixels, by_global, by_view = predict(session, state)
    residuals = (session.pixels - pixels) / sigmas.pixel
    distance = np.linalg.norm(residuals, axis=1)
    weight = np.minimum(1.0, HUBER / np.maximum(distance, 1e-12))
    cost = np.where(distance <= HUBER, distance**2, 2 * HUBER * distance - HUBER**2).sum()
    root = (np.sqrt(weight) / sigmas.pixel)[:, None, None]
    rows = np.concatenate([by_global, by_view], -1) * root
    targets = residuals * np.sqrt(weight)[:, None]

    views, p = len(session.base_from_flange), by_global.shape[-1]
    blocks, sides = np.zeros((views, p + 6, p + 6)), np.zeros((views, p + 6))
    ends = np.searchsorted(session.view, np.arange(views + 1))
    for i, (first, last) in enumerate(pairwise(ends)):
        own = rows[first:last].reshape(-1, p + 6)
        blocks[i], sides[i] = own.T @ own, own.T @ targets[first:last].ravel()
    scaled = state.corrections / sigmas.correction
    cost += (scaled**2).sum()
    vv = blocks[:, p:, p:] + np.diag(sigmas.correction**-2)
    v = sides[:, p:] - scaled / sigmas.correction
    gg, g = blocks[:, :p, :p].sum(0), sides[:, :p].sum(0)
    for i, name in enumerate(session.free):
        if name in session.known:
            value, std = session.known[name]
            off = (value - state.intrinsics[projection.NAMES.index(name)]) / std
            gg[i, i], g[i], cost = gg[i, i] + std**-2, g[i] + off / std, cost + off**2
    return _System(gg, blocks[:, :p, p:], vv, g, v, float(cost))


def _reduced(system: _System) -> tuple[Array, Array, Array]:
    """Schur complement of the views (p, p), its right-hand side (p,), and (views, p, 6) gv @ inverse(vv)."""
    eliminated = np.swapaxes(np.linalg.solve(system.vv, np.swapaxes(system.gv, 1, 2)), 1, 2)
    information = system.gg - np.einsum("vik,vjk->ij", eliminated, system.gv)
    return (information + information.T) / 2, system.g - np.einsum("vik,vk->i", eliminated, system.v), eliminated


def _minimise(session: Session, state: State, sigmas: Sigmas, max_steps: int = 50) -> tuple[State, int]:
    """Levenberg-Marquardt (Marquardt 1963's scaling by the diagonal) until a step changes the cost by less than 1e-9 of it."""
    damping, steps = 1e-4, 0
    system = _system(session, state, sigmas)
    while steps < max_steps and damping < 1e10:
        information, side, _ = _reduced(system)
        scale = np.sqrt(np.diag(system.gg))
        damped = information / np.outer(scale, scale) + damping * np.eye(len(scale))
        try:
            step = cho_solve(cho_factor(damped), side / scale) / scale
            view_steps = np.linalg.solve(system.vv, (system.v - np.einsum("vik,i->vk", system.gv, step))[..., None])[..., 0]
            candidate = state.moved(session.columns, step, view_steps)
            following = _system(session, candidate, sigmas)
        except (np.linalg.LinAlgError, CalibrationError):
            damping *= 10
            continue
        if not following.cost <= system.cost:
            damping *= 10
            continue
        gained = system.cost - following.cost
        state, system, damping, steps = candidate, following, max(damping / 10, 1e-12), steps + 1
        if gained <= 1e-9 * max(system.cost, 1.0):
            break
    return state, steps


def _estimated_sigmas(session: Session, state: State, sigmas: Sigmas, system: _System, residuals: Array) -> Sigmas:
    """Sigmas that explain what is left: sums of squares over the degrees of freedom that the fit left to each kind of error."""
    information, _, eliminated = _reduced(system)
    covariance = np.linalg.pinv(information, hermitian=True)
    of_views = np.linalg.inv(system.vv) + np.einsum("vik,ij,vjl->vkl", eliminated, covariance, eliminated)
    share = np.clip(np.diagonal(of_views, axis1=1, axis2=2) / sigmas.correction**2, 0, 1)  # 1: the corners say nothing
    views = len(share)

    def of_arm(columns: slice, stated: float) -> float:
        prior, freedom = 3 * PRIOR_VIEWS, 3 * views - share[:, columns].sum()
        return float(np.sqrt((prior * stated**2 + (state.corrections[:, columns] ** 2).sum()) / (prior + freedom)))

    freedom = max(2 * len(residuals) - len(information) - 6 * views + share.sum(), 0.1 * len(residuals))
    clipped = np.minimum(np.linalg.norm(residuals, axis=1), HUBER * sigmas.pixel)
    return Sigmas(
        max(float(np.sqrt((clipped**2).sum() / freedom)), 1e-4),
        of_arm(slice(0, 3), session.accuracy.translation_m), of_arm(slice(3, 6), session.accuracy.rotation_rad),
    )  # fmt: skip
