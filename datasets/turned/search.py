"""All motions on which two sessions' outlines agree, looked for from everywhere."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.turned.outlines import Outlines
from koala3d.datasets.turned.tangency import Fit, Pairs

Array = NDArray[np.float64]
STARTS = 300
"""Rotations from which the search starts: 99 of 100 others are within 29 degrees of one of them, and from 30 degrees away the
objects of the simulated laboratory are nearly always found."""
ROUNDS = ((8, 20, 5, 24), (14, 48, 10, 6))
"""Of each round but the last: views and corners that are compared, steps, and how many of the motions go on."""
MOST = 30
"""Steps of the last round, with all that there is."""
APART = np.deg2rad(4.0)
"""Motions whose turns differ by less are one."""
AGREE = 1.2
"""Outlines near what the object stands on count if they raise the misfit of the best motion to so many times at most. Those of
masks drawn from a mesh raise it to 1.1 times, those of masks that `datasets mask` finds to 1.4 to 3.5 times."""


def found(a: Outlines, b: Outlines, starts: Sequence[Array], *, done: Step = ignore) -> tuple[Pairs, list[Fit]]:
    """The motions a_from_b that fit best, each once, the best first; and the pairs by which they were found.

    Args:
        starts: (3, 3) rotations, or (4, 4) motions. A rotation starts with the outlines' middles on each other.
        done: called after each start.
    """
    motions = [_with_middles(a, b, start) for start in starts]
    for number, (views, corners, steps, kept) in enumerate(ROUNDS):
        pairs, fits = Pairs(a.some(views, corners), b.some(views, corners)), []
        for motion in motions:
            fits.append(pairs.refined(motion, steps))
            if not number:
                done()
        motions = [fit.a_from_b for fit in _different(fits)[:kept]]
    pairs, whole = Pairs(a, b), Pairs(a, b, low=True)
    fits = _different([pairs.refined(motion, MOST) for motion in motions])
    if whole.misfit(fits[0].a_from_b, fits[0].border) > AGREE * fits[0].misfit:
        return pairs, fits
    return whole, _different([whole.refined(fit.a_from_b, MOST) for fit in fits])


def _with_middles(a: Outlines, b: Outlines, start: Array) -> Array:
    return start if start.shape == (4, 4) else pose.rigid(start, a.middle - start @ b.middle)


def _different(fits: Sequence[Fit]) -> list[Fit]:
    """The fits by quality, without those that turn as a better one does."""
    ordered, kept = sorted(fits, key=lambda fit: fit.misfit), list[Fit]()
    turns = np.stack([fit.a_from_b[:3, :3] for fit in ordered])
    apart = np.einsum("aij,bij->ab", turns, turns) < 1 + 2 * np.cos(APART)  # the trace of a rotation by an angle
    left = np.ones(len(ordered), bool)
    for index, fit in enumerate(ordered):
        if left[index]:
            kept.append(fit)
            left &= apart[index]
    return kept


def turned_by(fit: Fit, other: Fit) -> float:
    """Angle between two motions' turns [rad]."""
    return float(pose.rotation_angle(pose.inverse(other.a_from_b) @ fit.a_from_b))
