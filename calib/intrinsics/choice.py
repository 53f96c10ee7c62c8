"""Which lens predicts views best that its fit has not seen.

Each candidate is fitted to some views by least squares and judged on the others, of which only the poses are fitted. The usual
lens has k1 k2 p1 p2; another must lower the held-out error, and by more than views differ by chance. (If fewer coefficients were
the rule, one session in twenty would omit one for lack of views and give a principal point several deviations off.) A splined
lens (`calib.intrinsics.splined`) must do so as well, after a test whether corners ask for it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.intrinsics import bundle, projection, splined
from koala3d.calib.intrinsics.fitting import DIRECTIONS, fit, flat
from koala3d.calib.intrinsics.lenses import BROWN, USUAL, Lens
from koala3d.calib.targets.detection import Observation
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.splits import folds

GAIN = 0.002  # share by which another lens must lower the held-out error to be chosen
CHANCE, FISHEYE_CHANCE = 0.16, 0.025
"""How often the gain of another lens, or of a fisheye beside an ordinary one, may be one that views show by chance."""


def choose(observations: Sequence[Observation], first: Camera, poses: Array, lenses: Sequence[Lens]) -> tuple[Lens, Array]:
    """The lens that predicts unseen views best, and its errors as by `_held_out`.

    More and fewer coefficients are tried while that helps.
    """
    chosen = USUAL if USUAL in lenses else lenses[0]
    best = _held_out(observations, first, poses, chosen)
    usual = lenses.index(chosen)
    straight = [[lens for lens in part if not lens.fisheye] for part in (lenses[usual + 1 :], lenses[:usual][::-1])]
    for ladder in (*straight, [lens for lens in lenses if lens.fisheye and lens != chosen]):
        for lens in ladder:
            if not _worth_a_try(lens, first, lenses):
                break
            squares = _held_out(observations, first, poses, lens)
            if _is_better(squares, best, another_kind=lens.fisheye != chosen.fisheye):
                chosen, best = lens, squares
            elif not lens.fisheye:
                break
    return chosen, best


def with_knots(
    observations: Sequence[Observation], first: Camera, poses: Array, lens: Lens, best: Array, *, asked: bool
) -> tuple[Lens, Array]:
    """`lens` with knots, and its errors as by `_held_out`; if `asked`, only where corners ask for knots and unseen views gain."""
    count = sum(len(o.ids) for o in observations)
    if asked and count < splined.MIN_CORNERS:
        return lens, best
    base = USUAL if lens in BROWN and set(lens.coefficients) < set(USUAL.coefficients) else lens
    camera, fitted = fit(observations, first, poses, base)
    camera, sigma_px = splined.flat(camera, count), float(np.sqrt(fitted.variance))
    corners, boards = flat(observations), fitted.camera_from_board
    if asked and not splined.asked_for(corners, camera, boards, base.free, sigma_px):
        return lens, best
    knotted = replace(base, grid=projection.form(camera).grid)
    squares = _held_out(observations, first, poses, knotted)
    if not asked and not np.isfinite(squares).all():
        raise CalibrationError("splined lens cannot be fitted", why="parts of the views do not allow it", remedy=DIRECTIONS)
    return (knotted, squares) if not asked or _is_better(squares, best, another_kind=True) else (lens, best)


def _is_better(squares: Array, best: Array, another_kind: bool) -> bool:
    """Whether (views,) sums of squared held-out errors are lower than the best so far, by more than these differ by chance.

    The gain is compared with its differences between views (paired Student's test).
    """
    if not (np.isfinite(best).all() and np.isfinite(squares).all()):
        return bool(np.isfinite(squares).all())
    gained, chance = best - squares, FISHEYE_CHANCE if another_kind else CHANCE
    margin = float(student.isf(chance, len(gained) - 1)) * np.sqrt(len(gained)) * np.std(gained, ddof=1)
    return bool(squares.sum() < (1 - GAIN) ** 2 * best.sum() and gained.sum() > margin)


def _worth_a_try(lens: Lens, first: Camera, lenses: Sequence[Lens]) -> bool:
    """Fisheyes are tried on request, and for images that reach 35 degrees and more off the axis."""
    reach = np.hypot(first.width, first.height) / 2 / min(first.fx, first.fy)
    return not lens.fisheye or all(other.fisheye for other in lenses) or reach > np.tan(np.deg2rad(35))


def _held_out(observations: Sequence[Observation], first: Camera, poses: Array, lens: Lens) -> Array:
    """(views,) sums of squared errors [px^2] of views that a fit has not seen, in up to four folds; infinite where one fails."""
    count, failed = min(4, len(observations) // 2), np.full(len(observations), np.inf)
    squares, fold_of = failed.copy(), folds(len(observations), count)
    try:
        if lens.fisheye:  # from poses by an ordinary lens, of views far off the axis, single views may not find to theirs
            poses = fit(observations, first, poses, lens)[1].camera_from_board
        for fold in range(count):
            rest, unseen = ([o for i, o in enumerate(observations) if (fold_of[i] == fold) == held] for held in (False, True))
            camera, _ = fit(rest, first, poses[fold_of != fold], lens)
            start, corners = projection.vector(camera), flat(unseen)
            residuals = bundle.fit(corners, start, poses[fold_of == fold], form=lens.form).residuals
            squares[fold_of == fold] = np.bincount(corners.view, (residuals**2).sum(-1), len(unseen))
    except (KoalaError, ArithmeticError):
        return failed
    return squares if np.isfinite(squares).all() else failed
