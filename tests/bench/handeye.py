"""Run time against error: every closed form and the refinement on simulated sessions, beside the Cramér-Rao bound.

A point of the benchmark is a noise level and a number of views. Each trial is one simulated session, whose board poses come
from its corners by least squares. The bound is the smallest covariance of any unbiased method: the inverse information at the
truth. Errors of a finite sample scatter around it by several percent. The efficient estimator, known only to a simulation, is
therefore measured as well: it is the truth plus one Gauss-Newton step on the same noise, and shows how lucky the draws were
(`tests.bench.ratios`). Times are those of the processor.

The best of seven closed forms in a few hundred trials is partly the luckiest. The refinement is therefore compared with the
one that was best in the other half of the trials, and points where the two are nearly equal get more trials.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from koala3d.calib.advice.patterns import Rig, ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, Simulated, simulate
from koala3d.calib.arrays import Array
from koala3d.calib.handeye import closed_forms, refine
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import bundle
from koala3d.datasets import pose
from koala3d.datasets.calibration import UncertainPose
from koala3d.datasets.core import console
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.files import refuse_existing
from koala3d.datasets.targets.board import Board
from tests.bench import ratios
from tests.bench.ratios import Ratio

RIG = replace(KOALA, board=Board.of("chessboard", 7, 6, 0.04))  # the Koala rig with a board of 30 corners, seen whole
REFINED, DRAWN, BOUND = "refinement", "bound as drawn", "bound"
FLOOR = Accuracy(1e-6, float(np.deg2rad(1e-4)))  # stated accuracy of an arm without error
ESTIMATED = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


@dataclass(frozen=True)
class Point:
    """Where methods are compared: standard deviations per axis, and the number of views."""

    sigma_px: float
    arm_mm: float
    arm_deg: float
    views: int
    free: tuple[str, ...] = ()  # intrinsics that are estimated; for the closed forms from the pictures alone

    @property
    def arm(self) -> Accuracy:
        """True accuracy of the arm."""
        return Accuracy(1e-3 * self.arm_mm, float(np.deg2rad(self.arm_deg)))

    @property
    def stated(self) -> Accuracy:
        """Stated accuracy of the arm."""
        return Accuracy(max(self.arm.translation_m, FLOOR.translation_m), max(self.arm.rotation_rad, FLOOR.rotation_rad))


@dataclass
class Errors:
    """Errors of one method at one point, a value per successful trial."""

    translation_mm: list[float] = field(default_factory=list)
    rotation_deg: list[float] = field(default_factory=list)
    time_ms: list[float] = field(default_factory=list)
    failures: int = 0

    def add(self, truth: Array, found: Array, seconds: float) -> None:
        """Count one answer."""
        for values, value in zip((self.translation_mm, self.rotation_deg), pose.rms_difference(truth, found), strict=True):
            values.append(value)
        self.time_ms.append(1e3 * seconds)

    def of(self, axis: int) -> list[float]:
        """Errors of all trials: translation [mm] for 0, rotation [deg] for 1."""
        return (self.translation_mm, self.rotation_deg)[axis]

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square error (translation [mm], rotation [deg]); infinite where a trial failed."""
        if self.failures or not self.translation_mm:
            return np.inf, np.inf
        return float(np.sqrt(np.mean(np.square(self.translation_mm)))), float(np.sqrt(np.mean(np.square(self.rotation_deg))))

    @property
    def median(self) -> tuple[float, float]:
        """Median error (translation [mm], rotation [deg]); NaN where every trial failed."""
        if not self.translation_mm:
            return np.nan, np.nan
        return float(np.median(self.translation_mm)), float(np.median(self.rotation_deg))


@dataclass(frozen=True)
class Result:
    """One point measured."""

    point: Point
    methods: dict[str, Errors]  # by name: closed forms, `REFINED`, `DRAWN`
    bound: tuple[float, float]  # smallest rms error of an unbiased method (translation [mm], rotation [deg])

    @property
    def best(self) -> tuple[str, str]:
        """Closed form with the smallest rms error (in translation, in rotation); of those that failed, the first."""
        closed = [name for name in self.methods if name in closed_forms.METHODS]
        first, second = (min(closed, key=lambda name: self.methods[name].rms[axis]) for axis in (0, 1))
        return first, second

    @property
    def trials(self) -> int:
        """Sessions that were simulated."""
        return len(self.methods[DRAWN].translation_mm)

    @property
    def close_call(self) -> bool:
        """Whether a closed form did nearly as well as the refinement, or better, with errors worth a comparison."""
        refined, best = self.methods[REFINED].rms, self.best
        return any(refined[axis] > max(EXACT[axis], CLOSE_CALL * self.methods[best[axis]].rms[axis]) for axis in (0, 1))

    def against_best(self) -> tuple[Ratio, Ratio]:
        """Rms error of the refinement in units of the best closed form's (translation, rotation), chosen without luck."""
        return self._both(lambda axis: ratios.of_errors(self.methods[REFINED].of(axis), self._best_elsewhere(axis)))

    def _best_elsewhere(self, axis: int) -> Array:
        """(trials,) errors: in each half of the trials those of the closed form that is best in the other half."""
        closed = [self.methods[name] for name in closed_forms.METHODS if name in self.methods and not self.methods[name].failures]
        if not closed:
            return np.empty(0)
        errors = np.array([method.of(axis) for method in closed])
        half = np.arange(self.trials) % 2
        chosen = [int(np.square(errors[:, half != own]).sum(1).argmin()) for own in (0, 1)]
        return np.where(half == 0, errors[chosen[0]], errors[chosen[1]])

    def against_bound(self) -> tuple[Ratio, Ratio]:
        """Rms error of the refinement in units of the bound (translation, rotation), the luck of the draws taken out."""
        refined, drawn = self.methods[REFINED], self.methods[DRAWN]
        return self._both(lambda axis: ratios.to_bound(refined.of(axis), drawn.of(axis), self.bound[axis]))

    def plainly_against_bound(self) -> tuple[float, float]:
        """The same as a plain quotient of what was drawn and the bound."""
        refined = self.methods[REFINED].rms
        return refined[0] / self.bound[0], refined[1] / self.bound[1]

    def _both(self, compared: Callable[[int], Ratio]) -> tuple[Ratio, Ratio]:
        """A ratio for each of translation and rotation, where there is anything to compare."""

        def one(axis: int) -> Ratio:
            if self.methods[REFINED].failures:
                return ratios.WORSE
            return ratios.EQUAL if self.methods[REFINED].rms[axis] <= EXACT[axis] else compared(axis)

        return one(0), one(1)


CLOSE_CALL = 0.99  # ratio to the best closed form from which on a point gets `MORE` times as many trials
MORE = 5
EXACT = (1e-4, 1e-5)  # errors (translation [mm], rotation [deg]) below which an answer counts as exact: a tenth of a micrometre


def full_grid() -> list[Point]:
    """Noise 0 to 1 px, 0 to 1 mm, 0 to 0.1 degrees, 5 to 50 views, intrinsics given; around the Koala rig also estimated."""
    known = [Point(*levels) for levels in product((0.0, 0.1, 1.0), (0.0, 0.03, 1.0), (0.0, 0.005, 0.1), (5, 10, 20, 50))]
    rigs = (0.1, 0.03, 0.005), (0.3, 0.1, 0.02), (1.0, 1.0, 0.1)
    return known + [Point(*levels, views, ESTIMATED) for levels, views in product(rigs, (10, 20, 50))]


def quick_grid() -> list[Point]:
    """A few points that show each regime."""
    known = [Point(*levels) for levels in product((0.1, 1.0), (0.03, 1.0), (0.005, 0.1), (10, 25))]
    return [*known, Point(0.0, 0.0, 0.0, 10), Point(0.1, 0.03, 0.005, 25, ESTIMATED)]


def run(
    points: Sequence[Point], trials: int, seed: int, *, rig: Rig = RIG, done: Callable[[Result], None] = lambda result: None
) -> Iterator[Result]:
    """Measure `points` with `trials` sessions each, and with `MORE` times as many where the result is close."""
    for number, point in enumerate(points):
        result = measure(point, trials, np.random.default_rng([seed, number]), rig, more=MORE)
        done(result)
        yield result


def measure(point: Point, trials: int, rng: np.random.Generator, rig: Rig = RIG, *, more: int = 1) -> Result:
    """Measure every method at one point with `trials` sessions, or `more` times as many if the result is close."""
    methods = {name: Errors() for name in (*closed_forms.METHODS, REFINED, DRAWN)}
    variances: list[Array] = []
    while True:
        for _ in range(trials - len(variances)):
            variances.append(_trial(point, rng, rig, methods))
        least = np.sqrt(np.mean(variances, axis=0))
        result = Result(point, methods, (1e3 * float(least[0]), float(np.rad2deg(least[1]))))
        if more == 1 or not result.close_call:
            return result
        trials, more = trials * more, 1


def _trial(point: Point, rng: np.random.Generator, rig: Rig, methods: dict[str, Errors]) -> Array:
    """(2,) what `bound` says of one session, whose errors are counted."""
    sigmas = refine.Sigmas(max(point.sigma_px, refine.MIN_SIGMA_PX), point.stated.translation_m, point.stated.rotation_rad)
    flown = viewpoints(rng, rig, point.views, ViewRange())
    drawn = simulate(rng, rig, flown, sigma_px=point.sigma_px, arm=point.arm, free=point.free)
    drawn = replace(drawn, session=replace(drawn.session, accuracy=point.stated))
    methods[DRAWN].add(drawn.truth.mount_from_camera, efficient(drawn, sigmas), 0.0)
    _compare(drawn, point, methods)
    return bound(drawn, sigmas)


def _compare(drawn: Simulated, point: Point, methods: dict[str, Errors]) -> None:
    """All closed forms, then the refinement from the best of them by residual, as `calib handeye` does."""
    session, truth = drawn.session, drawn.truth
    corners = bundle.Corners(session.view, session.pixels, session.points)
    seen = bundle.fit(corners, truth.intrinsics, drawn.camera_from_board, point.free)
    answers = []
    for name in closed_forms.METHODS:
        start = time.process_time()
        try:
            answer = closed_forms.solve(session.base_from_flange, seen.camera_from_board, name)
        except KoalaError:
            methods[name].failures += 1
            continue
        methods[name].add(truth.mount_from_camera, answer.mount_from_camera, time.process_time() - start)
        answers.append(answer)
    best = min(answers, key=lambda answer: answer.score(np.ones(point.views, bool)))
    start = time.process_time()
    first = State(seen.intrinsics, best.mount_from_camera, best.stand_from_board, np.zeros((point.views, 6)))
    try:
        refined = refine.refine(session, first, sigma_px=_spread(seen.residuals, point.views, len(point.free)))
    except KoalaError:
        methods[REFINED].failures += 1
        return
    methods[REFINED].add(truth.mount_from_camera, refined.state.mount_from_camera, time.process_time() - start)


def _spread(residuals: Array, views: int, free: int) -> float:
    """Standard deviation of a corner [px] from what a fit of (6 x views + free) unknowns left."""
    return max(float(np.sqrt((residuals**2).sum() / (residuals.size - 6 * views - free))), refine.MIN_SIGMA_PX)


def efficient(drawn: Simulated, sigmas: refine.Sigmas) -> Array:
    """(4, 4) hand-eye pose of an efficient estimator: the truth plus one Gauss-Newton step on the session's noise."""
    step, _ = refine.linear_system(drawn.session, drawn.truth, sigmas).step(0.0)
    return drawn.session.moved(drawn.truth, step, 0 * drawn.truth.corrections).mount_from_camera


def bound(drawn: Simulated, sigmas: refine.Sigmas) -> Array:
    """(2,) variances of the hand-eye pose over all axes that a session allows: translation [m^2], rotation [rad^2]."""
    inverse = np.linalg.inv(refine.linear_system(drawn.session, drawn.truth, sigmas).root)
    stated = UncertainPose(drawn.truth.mount_from_camera, (inverse @ inverse.T)[-12:-6, -12:-6])
    return np.square(np.array(stated.total_std) * [1e-3, np.deg2rad(1)])


def main(
    out: Annotated[Path, typer.Option("--out", help="Folder to write: bench.csv, bench.md, bench.png.")],
    quick: Annotated[bool, typer.Option("--quick", help="Measure a few points in one minute instead of all in 45.")] = False,
    trials: Annotated[int, typer.Option("--trials", min=2, help="Sessions per point.")] = 200,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the noise.")] = 0,
) -> None:
    """Measure run time and error of all hand-eye methods on simulated sessions without pictures."""
    from tests.bench import handeye_report

    refuse_existing(out)
    points = quick_grid() if quick else full_grid()
    with console.progress("measuring", len(points), "points") as bar:
        results = list(run(points, trials, seed, done=lambda result: bar.advance()))
    handeye_report.write(out, results)
    print(f"{handeye_report.describe(results)}\nwritten to {out}")


if __name__ == "__main__":
    typer.run(main)
