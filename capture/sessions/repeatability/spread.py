"""How far the seen pose of a target varies between visits: spread, drift, and how uncertain both are.

The pictures of view m in visit n show the target's middle at y_mn = [position (mm), turn (mdeg)] along the axes of the base, with
the arm taken to be where it was in the first visit. The model for each of the six components is

    y_mn = mean_m + drift g(t_mn) + visit_mn + seeing_mn,    g(t) = (1 - exp(-t / tau)) / (1 - exp(-t_end / tau))

with one tau and one drift for all views. A large tau makes g a straight line. The residuals of this fit have the variance of
`visit`, which is wanted, and of `seeing`. The latter comes from corners that are seen a little off, by noise and by how pixels
happen to lie: the residuals of the corners, less their mean over all visits to the view, have that variance, and the geometry of
the view says what it does to the pose. It is subtracted (analysis of variance of a random effect).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError

Array = NDArray[np.float64]
AXES = ("x_mm", "y_mm", "z_mm", "x_mdeg", "y_mdeg", "z_mdeg")
"""Position of the target's middle along the axes of the base, and turns about them."""
UNITS = np.array([1e3] * 3 + [1e3 * 180 / np.pi] * 3)
"""Of `AXES`, in metres and radians."""
TAUS = np.geomspace(0.1, 30.0, 41)
"""Time constants that are tried, in units of the session's length; the last is a straight line to 2 %."""
LEAST_VISITS = 3
LEAST_WARMING = 0.5
"""Smaller changes of temperature say nothing: joints report it in steps of a few tenths of a degree."""
SEEING_SHARE = 1.0
"""Relative standard error of the variance of `seeing`. Errors of neighbouring corners are not independent, as it assumes: in
simulated sessions of 30 visits the true one was 0.6 to 2 times as large."""


@dataclass(frozen=True)
class SeenVisit:
    """What the pictures of one visit to one view show, in the mean."""

    view: int
    visit: int
    time_s: float
    temperature: float | None  # mean of the joints [degrees Celsius]
    base_from_middle: Array  # (4, 4) the target's middle, as if the arm were where it was in the first visit [m]
    covariance: Array  # (6, 6) of that place and turn along the axes of the base for corners off by one pixel [m, rad]
    residuals: dict[str, Array]  # (2,) by corner [px]


@dataclass(frozen=True)
class Repeatability:
    """Six components each, in the order of `AXES`, with standard errors."""

    spread: Array  # standard deviation of a visit, without drift and seeing
    spread_error: Array
    seeing: Array  # standard deviation by which the corners of a visit's pictures are seen off
    drift: Array  # from the first visit to the last
    drift_error: Array
    per_degree: Array | None  # change with the mean temperature of the joints [per degree]; None: not reported, or constant
    per_degree_error: Array | None
    minutes: float
    warming: float | None  # by how much the joints became warmer [degrees]
    deviations: Array  # (stops, 6) each visit less the mean of its view
    visits: Array  # (stops,) number of the visit
    views: Array  # (stops,) number of the view
    times_s: Array  # (stops,) since the first visit
    curve: Array  # (stops, 6) the drift at these times

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary: each figure by its axis."""

        def named(values: Array | None) -> dict[str, float] | None:
            return None if values is None else dict(zip(AXES, map(float, values), strict=True))

        figures = {name: named(getattr(self, name)) for name in ("spread", "spread_error", "seeing", "drift", "drift_error")}
        figures |= {"per_degree": named(self.per_degree), "per_degree_error": named(self.per_degree_error)}
        stops = [
            {"view": int(view), "visit": int(visit), "time_s": float(at), **(named(deviation) or {})}
            for view, visit, at, deviation in zip(self.views, self.visits, self.times_s, self.deviations, strict=True)
        ]
        return {**figures, "minutes": self.minutes, "warming": self.warming, "stops": stops}


def repeatability(seen: list[SeenVisit]) -> Repeatability:
    """The figures of a session. Raises DatasetError: fewer than `LEAST_VISITS` visits show the target."""
    of_view = {view: [one for one in seen if one.view == view] for view in sorted({one.view for one in seen})}
    kept = sorted((one for group in of_view.values() if len(group) > 1 for one in group), key=lambda one: one.time_s)
    if (visits := len({one.visit for one in kept})) < LEAST_VISITS:
        remedy = "take the missing visits with --resume, or choose more --visits"
        raise DatasetError("too few visits show the target", why=f"{visits}, at least {LEAST_VISITS} are needed", remedy=remedy)
    means = np.stack([_components(one, of_view[one.view][0]) for one in kept])
    views = np.array([one.view for one in kept])
    times = np.array([one.time_s for one in kept]) - kept[0].time_s
    drifted = _fitted(means, views, times)
    seeing = np.mean([_seeing(of_view[one.view], one) for one in kept], axis=0)
    spread = np.sqrt(np.maximum(drifted.squares - seeing, 0.0))
    uncertain = np.sqrt(2 * drifted.squares**2 / drifted.dof + (SEEING_SHARE * seeing) ** 2)
    warming, per_degree, per_degree_error = _against_temperature(kept, means, views)
    return Repeatability(
        spread=spread,
        # to first order u / (2 s) where u is that of s^2; near zero at most sqrt(u)
        spread_error=uncertain / np.maximum(2 * spread, np.sqrt(uncertain)),
        seeing=np.sqrt(seeing),
        drift=drifted.total,
        drift_error=drifted.error,
        per_degree=per_degree,
        per_degree_error=per_degree_error,
        minutes=float(times.max() / 60),
        warming=warming,
        deviations=means - _by_view(means, views),
        visits=np.array([one.visit for one in kept]),
        views=views,
        times_s=times,
        curve=drifted.curve - _by_view(drifted.curve, views),
    )


def _seeing(group: list[SeenVisit], one: SeenVisit) -> Array:
    """(6,) variance of what one of the visits to a view shows, by what the corners' residuals vary between them."""
    common = set.intersection(*(set(visit.residuals) for visit in group))
    if len(common) < 4:
        return np.zeros(6)
    vectors = np.array([[visit.residuals[corner] for corner in sorted(common)] for visit in group])
    dof = (len(group) - 1) * max(2 * len(common) - 6, 1)
    square = ((vectors - vectors.mean(0)) ** 2).sum() / dof
    return np.asarray(square * np.diag(one.covariance) * UNITS**2, np.float64)


def _components(one: SeenVisit, first: SeenVisit) -> Array:
    """(6,) position [mm] and turn [mdeg] relative to the first visit to the view, along the axes of the base."""
    turn = one.base_from_middle[:3, :3] @ first.base_from_middle[:3, :3].T
    moved = one.base_from_middle[:3, 3] - first.base_from_middle[:3, 3]
    return UNITS * np.concatenate([moved, pose.rotation_vector(turn)])


def _by_view(values: Array, views: NDArray[np.int64]) -> Array:
    """(stops, 6) the mean of each stop's view."""
    return np.stack([values[views == view].mean(0) for view in views])


@dataclass(frozen=True)
class _Drift:
    total: Array  # (6,) from the first stop to the last
    error: Array  # (6,)
    squares: Array  # (6,) variance of the residuals
    dof: float
    curve: Array  # (stops, 6)


def _fitted(means: Array, views: NDArray[np.int64], times: Array) -> _Drift:
    """The drift with the time constant that leaves least, all components in units of what a straight line leaves."""
    end = max(float(times.max()), 1e-9)
    scale = np.maximum(_regressed(means, views, times / end).squares, 1e-12)
    best = min(
        (_regressed(means, views, -np.expm1(-times / (tau * end)) / -np.expm1(-1 / tau)) for tau in TAUS),
        key=lambda fit: float((fit.squares / scale).sum()),
    )
    dof = best.dof - 1 / 6  # the time constant is shared by six components
    return _Drift(best.total, best.error, best.squares * best.dof / dof, dof, best.curve)


def _regressed(means: Array, views: NDArray[np.int64], shape: Array) -> _Drift:
    """Least squares of a level for each view and one slope along `shape` (stops,)."""
    inside = shape - _by_view(shape[:, None], views)[:, 0]
    level = means - _by_view(means, views)
    length = max(float(inside @ inside), 1e-12)
    slope = inside @ level / length
    dof = float(max(len(means) - len(np.unique(views)) - 1, 1))
    squares = ((level - inside[:, None] * slope) ** 2).sum(0) / dof
    return _Drift(slope, np.sqrt(squares / length), squares, dof, shape[:, None] * slope)


def _against_temperature(
    kept: list[SeenVisit], means: Array, views: NDArray[np.int64]
) -> tuple[float | None, Array | None, Array | None]:
    """By how much the joints became warmer, the change per degree and its standard error; None: the controller does not say."""
    read = [one.temperature for one in kept if one.temperature is not None]
    if len(read) < len(kept):
        return None, None, None
    degrees = np.array(read)
    if np.ptp(degrees) < LEAST_WARMING:
        return float(degrees[-1] - degrees[0]), None, None
    fit = _regressed(means, views, degrees)
    return float(degrees[-1] - degrees[0]), fit.total, fit.error
