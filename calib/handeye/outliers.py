"""Views whose arm pose and picture disagree by more than chance: the refinement finds them, and they are left out by name.

The refinement gives every view a correction of the arm's report. Good views need corrections of similar size. A view that was
taken before the arm had settled, or after somebody touched the board, needs one that is many times larger.
"""

from dataclasses import dataclass, replace

import numpy as np

from koala3d.calib.arrays import Mask
from koala3d.calib.handeye import model, refine, uncertainty
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.intrinsics.estimate import MIN_TOTAL_CORNERS, check_enough
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.intrinsics.projection import PLAIN, Form
from koala3d.calib.sessions.session import TargetSession

LIMIT = 6.0  # a view is left out if its correction is this many times the usual one; chance does that once in ten million views
MAX_SHARE = 0.4  # largest share of views that is left out: if more disagree, the arm is less accurate than stated
MEDIAN_LENGTH = 1.538  # median length of a Gaussian vector in three dimensions, in standard deviations


@dataclass(frozen=True)
class Fit:
    """A refinement and its input."""

    session: TargetSession
    measured: Measurements
    refined: Refined
    left_out: dict[str, str]


def refine_without(
    session: TargetSession,
    start: State,
    free: tuple[str, ...],
    known: IntrinsicsPrior | None,
    accuracy: Accuracy,
    *,
    sigma_px: float,
    form: Form = PLAIN,
) -> Fit:
    """Refine from `start`, leaving out views that disagree, one round after another.

    Raises TargetError, Unobservable or CalibrationError where too little is left, or nothing fits.
    """
    allowed, left_out = int(MAX_SHARE * len(session.observations)), {}
    while True:
        check_enough(session.observations, MIN_TOTAL_CORNERS if free and known is None else 0)
        uncertainty.check_motion(session.base_from_flange)
        measured = model.measured(session, free, known, accuracy, form)
        refined = refine.refine(measured, start, sigma_px=sigma_px)
        bad = disagreeing(refined, accuracy)
        if not bad.any() or len(left_out) + bad.sum() > allowed:
            return Fit(session, measured, refined, left_out)
        sizes = np.linalg.norm(refined.state.corrections.reshape(-1, 2, 3), axis=2)
        for i in np.flatnonzero(bad):
            why = f"arm and picture disagree by {1e3 * sizes[i, 0]:.2g} mm and {np.rad2deg(sizes[i, 1]):.2g} deg"
            left_out[session.observations[i].name] = why
        session = session.chosen(~bad)
        start = replace(refined.state, corrections=np.zeros((len(session.observations), 6)))


def disagreeing(refined: Refined, accuracy: Accuracy) -> Mask:
    """(views,) whose correction is larger than `LIMIT` times the usual one, and than what the arm is stated to do."""
    sizes = np.linalg.norm(refined.state.corrections.reshape(-1, 2, 3), axis=2)  # (views, 2): translation, rotation
    usual = np.maximum(np.median(sizes, axis=0) / MEDIAN_LENGTH, 0.5 * np.array([accuracy.translation_m, accuracy.rotation_rad]))
    return (sizes > LIMIT * usual).any(1)
