"""Refinement of the whole rig: everything unknown in a target session, estimated together by maximum likelihood.

With the predictions and the corrections C[i] of `calib.handeye.model`, Levenberg-Marquardt with analytic derivatives minimises

    sum huber(|seen - predicted| / sigma_px)  +  sum |translation(C[i]) / sigma_t|^2 + |rotation(C[i]) / sigma_r|^2
    + prior knowledge of the intrinsics, and |offset / its stated deviation|^2 of each joint.

A view's correction affects its own corners only and is eliminated view by view (`calib.solver.elimination`). If no residual
is larger than expected from Gaussian noise, the loss is the plain square, which is most efficient; Huber's loss is for
sessions with outliers. The three sigmas are estimated as well (MacKay 1992, eq. 4.9): sigma_px from the residuals alone,
sigma_t and sigma_r starting from the stated accuracy of the arm, which counts as much as `PRIOR_VIEWS` views.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from koala3d.calib.arrays import Array, Indices, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye.model import Accuracy, Measurements, State, perturbed, predict
from koala3d.calib.solver.elimination import Eliminated, eliminate
from koala3d.calib.solver.levenberg_marquardt import Limits, minimise

HUBER = 3.0  # width of Huber's loss in sigmas, in a session with outliers; a good corner exceeds it once in 90 times
CHANCE = 0.01  # share of sessions without outliers that are taken to have some, because their largest residual is rare
OUTLIER = 6.0  # corners with larger residuals are left out [sigmas]
MIN_SIGMA_PX = 1e-4  # lower limit of a corner's standard deviation: smaller residuals are rounding errors
LIMITS = Limits(max_steps=50, tolerance=1e-9, least_cost=1.0, min_damping=1e-12)
PRIOR_VIEWS = 4.0  # the stated accuracy of the arm counts as much as this number of views


class Unknowns(Protocol):
    """What is estimated."""

    @property
    def corrections(self) -> Array:
        """(views, 6) of the arm's report."""
        ...


S = TypeVar("S", bound=Unknowns)


class Problem(Protocol[S]):
    """What is refined: `Measurements` with a `State`, or several cameras or targets (`calib.together.model`)."""

    @property
    def view(self) -> Indices:
        """(n,) view of each corner."""
        ...

    @property
    def pixels(self) -> Array:
        """(n, 2) corners as seen [px]."""
        ...

    @property
    def accuracy(self) -> Accuracy:
        """Of the arm, as stated."""
        ...

    def some(self, chosen: Mask) -> Self:
        """The same with the corners of `chosen` (n,) alone."""
        ...

    def predicted(self, state: S) -> tuple[Array, Array, Array]:
        """(n, 2) corners, (n, 2, p) their derivatives by the global unknowns, (n, 2, 6) those by their view's correction."""
        ...

    def moved(self, state: S, step: Array, view_steps: Array) -> S:
        """`state` after a step of (p,) global unknowns and (views, 6) corrections."""
        ...

    def known_rows(self, state: S) -> Array:
        """(k, p + 1) what is known of the global unknowns, whitened."""
        ...


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of the three kinds of error, per axis."""

    pixel: float
    translation_m: float
    rotation_rad: float
    width: float = np.inf  # width of Huber's loss [sigmas]; infinite: all residuals look Gaussian

    @property
    def correction(self) -> Array:
        """(6,) of a view's correction."""
        return np.repeat([self.translation_m, self.rotation_rad], 3)


@dataclass(frozen=True)
class Refined(Generic[S]):
    """The solution and whether it converged."""

    state: S
    sigmas: Sigmas  # as estimated
    information: Array  # (p, p) of the global parameters, the corrections eliminated: its inverse is their covariance
    residuals: Array  # (n, 2) seen minus predicted, outliers too [px]
    inliers: Mask  # (n,) corners that were used
    steps: int
    settled: bool  # whether sigmas and outliers stopped changing; if not, the solution may still move

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the corners that were used [px]."""
        return float(np.sqrt(np.mean(np.sum(self.residuals[self.inliers] ** 2, -1))))


def refine(session: Problem[S], start: S, *, sigma_px: float, rounds: int = 12) -> Refined[S]:
    """Minimise from `start`; `sigma_px` is a first guess of a corner's standard deviation per axis [px].

    Raises CalibrationError where the start is too far off, or nearly all corners are outliers.
    """
    sigmas = Sigmas(max(sigma_px, MIN_SIGMA_PX), session.accuracy.translation_m, session.accuracy.rotation_rad, HUBER)
    steps, settled, suspicious = 0, False, False
    inliers = np.ones(len(session.view), bool)
    point = _Point(session, start, sigmas)
    for number in range(rounds):
        found, count = minimise(point.weighed(sigmas, inliers), LIMITS)
        steps += count
        point = found if inliers.all() else _Point(session, found.state, sigmas)
        last, sigmas = sigmas, _estimated_sigmas(found)
        distance = np.linalg.norm(point.residuals, axis=1) / sigmas.pixel
        kept = distance <= OUTLIER
        gaussian = _look_gaussian(distance[kept])
        suspicious |= not (gaussian or np.isfinite(last.width))  # plain squares were tried: no second time
        sigmas = replace(sigmas, width=np.inf if gaussian and not suspicious else HUBER)
        if kept.sum() < 0.5 * len(kept):
            why = f"{(~kept).sum()} of {len(kept)} corners are outliers"
            remedy = "check that poses are flange poses in metres and belong to these images"
            raise CalibrationError("pictures and arm poses do not fit together", why=why, remedy=remedy)
        ratios = np.log([sigmas.pixel / last.pixel, *(sigmas.correction[[0, 3]] / last.correction[[0, 3]])])
        settled = number > 0 and bool((kept == inliers).all() and np.abs(ratios).max() < 0.01 and sigmas.width == last.width)
        inliers = kept
        if settled:
            break
    information = point.weighed(sigmas, inliers).system.information
    return Refined(point.state, sigmas, information, point.residuals, inliers, steps, settled)


def with_corrections(session: Measurements, state: State, sigmas: Sigmas) -> Refined[State]:
    """What `state` says of a session: each view gets the most likely correction, and everything else stays as it is.

    Raises CalibrationError where the target comes to lie behind the camera.
    """
    inliers, sigmas, settled = np.ones(len(session.view), bool), replace(sigmas, width=HUBER), False
    point = _Point(session, state, sigmas)
    for _ in range(12):
        for _ in range(5):  # Gauss-Newton; the problem is nearly linear
            point = _Point(session, point.weighed(sigmas, inliers).follow_views().state, sigmas)
        distance = np.linalg.norm(point.residuals, axis=1) / sigmas.pixel
        kept = distance <= OUTLIER
        width = np.inf if _look_gaussian(distance[kept]) else HUBER
        settled = bool((kept == inliers).all() and width == sigmas.width)
        inliers, sigmas = kept, replace(sigmas, width=width)
        if settled:
            break
    information = point.weighed(sigmas, inliers).system.information
    return Refined(point.state, sigmas, information, point.residuals, inliers, 0, settled)


def _look_gaussian(distances: Array) -> bool:
    """Whether the largest of (n,) residuals [sigmas] is within what Gaussian noise gives: a share exp(-d^2 / 2) exceeds d."""
    return bool(distances.max(initial=0.0) <= np.sqrt(2 * np.log(max(len(distances), 1) / CHANCE)))


def fit_board(session: Measurements, state: State, max_steps: int = 30) -> State:
    """`state` with the pose of the board fitted to the corners, by Gauss-Newton with Huber's weights."""
    for _ in range(max_steps):
        pixels, by_global, _ = predict(session, state)
        residuals = session.pixels - pixels
        distance = np.linalg.norm(residuals, axis=1)
        sigma = max(np.median(distance) / 1.1774, 1e-9)  # the median of a length in two dimensions is 1.1774 sigma
        root = np.sqrt(np.minimum(1.0, HUBER * sigma / np.maximum(distance, 1e-12)))[:, None]
        rows = (by_global[..., -6:] * root[..., None]).reshape(-1, 6)
        step = np.linalg.lstsq(rows, (residuals * root).ravel(), rcond=None)[0]
        state = replace(state, stand_from_board=perturbed(state.stand_from_board, step))
        if np.abs(step).max() < 1e-9:
            break
    return state


class _Point:
    """A state of a problem with its predictions, weighed by sigmas."""

    def __init__(self, session: Any, state: Any, sigmas: Sigmas, prediction: tuple[Array, ...] | None = None) -> None:
        self.session, self.state, self.sigmas = session, state, sigmas
        if prediction is None:
            pixels, by_global, by_view = session.predicted(state)
            prediction = session.pixels - pixels, by_global, by_view
        self._prediction = self.residuals, self._by_global, self._by_view = prediction
        self.cost = self._cost()

    def weighed(self, sigmas: Sigmas, chosen: Mask) -> "_Point":
        """The same state weighed by other sigmas, with the corners of `chosen` (n,) alone."""
        return _Point(self.session.some(chosen), self.state, sigmas, tuple(part[chosen] for part in self._prediction))

    def _cost(self) -> float:
        """What is minimised."""
        sigmas, state = self.sigmas, self.state
        distance = np.linalg.norm(self.residuals, axis=1) / sigmas.pixel
        cost = (distance**2 - np.maximum(distance - sigmas.width, 0.0) ** 2).sum()
        cost += ((state.corrections / sigmas.correction) ** 2).sum()
        return float(cost + (self.session.known_rows(state)[:, -1] ** 2).sum())

    @cached_property
    def system(self) -> Eliminated:
        """The linear problem, with corners beyond the loss's width weighed down and the corrections eliminated."""
        sigmas, state = self.sigmas, self.state
        distance = np.linalg.norm(self.residuals, axis=1) / sigmas.pixel
        root = (np.sqrt(np.minimum(1.0, sigmas.width / np.maximum(distance, 1e-12))) / sigmas.pixel)[:, None, None]
        rows = np.concatenate([self._by_view, self._by_global, self.residuals[..., None]], -1) * root
        own = np.zeros((len(state.corrections), 6, 7))
        own[:, range(6), range(6)], own[..., 6] = 1 / sigmas.correction, -state.corrections / sigmas.correction
        return eliminate(self.session.view, rows, own, self.session.known_rows(state))

    def stepped(self, damping: float) -> "_Point":
        """The point after one damped step.

        If the cost has not fallen, the corrections are solved once more. The more certain the corners, the narrower and more
        bent the valley in which corrections and global unknowns must move together (a second-order correction; Nocedal &
        Wright, 15.6).
        """
        candidate = _Point(self.session, self.session.moved(self.state, *self.system.step(damping)), self.sigmas)
        for _ in range(2):
            if candidate.cost <= self.cost:
                break
            candidate = candidate.follow_views()
        return candidate

    def follow_views(self) -> "_Point":
        """The point after a Gauss-Newton step of the corrections alone."""
        own = np.asarray(np.linalg.solve(self.system.own, self.system.own_side[..., None])[..., 0], np.float64)
        still = np.zeros(len(self.system.side))
        return _Point(self.session, self.session.moved(self.state, still, own), self.sigmas)


def linear_system(session: Problem[S], state: S, sigmas: Sigmas) -> Eliminated:
    """The linear problem about `state`: its information, and the Gauss-Newton step from there."""
    return _Point(session, state, sigmas).system


def _estimated_sigmas(point: _Point) -> Sigmas:
    """Sigmas that explain the residuals: for each kind of error, the sum of squares over its degrees of freedom."""
    session, state, sigmas, system = point.session, point.state, point.sigmas, point.system
    inverse = np.linalg.pinv(system.root)
    of_views = system.own_covariances(inverse @ inverse.T)
    share = np.clip(np.diagonal(of_views, axis1=1, axis2=2) / sigmas.correction**2, 0, 1)  # 1: the corners say nothing
    views = len(share)

    def of_arm(columns: slice, stated: float) -> float:
        prior, freedom = 3 * PRIOR_VIEWS, 3 * views - share[:, columns].sum()
        return float(np.sqrt((prior * stated**2 + (state.corrections[:, columns] ** 2).sum()) / (prior + freedom)))

    corners = len(point.residuals)
    freedom = max(2 * corners - len(system.root) - 6 * views + share.sum(), 0.1 * corners)
    clipped = np.minimum(np.linalg.norm(point.residuals, axis=1), sigmas.width * sigmas.pixel)
    pixel = max(float(np.sqrt((clipped**2).sum() / freedom)), MIN_SIGMA_PX)
    translation, rotation = session.accuracy.translation_m, session.accuracy.rotation_rad
    return Sigmas(pixel, of_arm(slice(0, 3), translation), of_arm(slice(3, 6), rotation), sigmas.width)
