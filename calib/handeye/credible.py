"""Calibrations that fit, and yet cannot be right.

The refinement finds how much the arm errs, from millimetres to the last digit. Rotations that mean something else than was said
look to it like an arm whose positions are good and whose rotations are not. No arm is like that: joints that turn the flange also
carry it along, as far as it is from their axes.
"""

import numpy as np

from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye.model import Accuracy
from koala3d.datasets.residuals import Residuals

LEVER_M = 0.02
"""An error of the joints that turns the flange by an angle moves it by that angle times this, at least: wrists are larger. Good
sessions have a tenth of it, real arms 0.03; rotations that are wrong by a degree have six times as much."""
TIMES, MANY_TIMES = 10.0, 50.0
"""Times the stated error of a rotation from which on it is looked at, and from which on one more sign suffices."""
LARGE_SHARE = 0.1
"""Share of corners left out that is such a sign; the other is that no error on unseen views could be found."""
_REMEDY = "check how rotations are written (Euler angles, their axes, degrees) and which pose belongs to which picture"


def check(residuals: Residuals, accuracy: Accuracy) -> None:
    """Raise CalibrationError where the errors of the arm are not those of an arm."""
    millimetres, degrees = residuals.arm_translation_mm, residuals.arm_rotation_deg
    if millimetres is None or degrees is None or not (times := np.deg2rad(degrees) / accuracy.rotation_rad) > TIMES:
        return
    found = f"positions are {millimetres:.2g} mm off, rotations {degrees:.2g} deg"
    if 1e3 * LEVER_M * np.deg2rad(degrees) > millimetres:
        raise CalibrationError("rotations of the arm do not belong to its positions", why=found, remedy=_REMEDY)
    if times > MANY_TIMES and (share := share_left_out(residuals)) > LARGE_SHARE:
        raise CalibrationError("arm and pictures do not fit", why=f"{found}, {share:.0%} of the corners left out", remedy=_REMEDY)
    if times > MANY_TIMES and residuals.held_out_px is None:
        raise CalibrationError("arm and pictures do not fit", why=f"{found}, unseen views not predictable", remedy=_REMEDY)


def share_left_out(residuals: Residuals) -> float:
    """Share of the corners that the fit left out; 0 where nobody counted."""
    out, kept = residuals.corners_left_out or 0, residuals.corners or 0
    return out / max(out + kept, 1)
