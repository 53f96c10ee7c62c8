"""Do the corners of a session ask for a target that is stretched or bent, where it was taken for an exact and flat one?"""

from dataclasses import replace

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.handeye import refine
from koala3d.calib.handeye.model import Measurements, State
from koala3d.calib.handeye.refine import Refined

TRIED = (0.005, 2e-3)
"""Stretch, and sag [m], that are taken for possible: a bad printer and a thin plate."""
SURE = (
    40.0  # squared distance from a flat target, over four unknowns, from which on it is said; chance exceeds 37 once in 5 million
)
WORTH = np.array([3e-4, 3e-4, 1e-4, 1e-4])  # smaller shapes are not said: lens models of other kinds leave as much


def asked_for(session: Measurements, refined: Refined[State]) -> Array | None:
    """(4,) `shape` that one Gauss-Newton step from the answer asks for; None where the target may as well be flat."""
    if session.shaped:
        return None
    tolerant = replace(session.some(refined.inliers), accuracy=replace(session.accuracy, stretch=TRIED[0], sag_m=TRIED[1]))
    system = refine.linear_system(tolerant, refined.state, refined.sigmas)
    first = len(session.free) + len(session.erring)
    step, inverse = system.step(0.0)[0], np.linalg.pinv(system.root)
    shape, covariance = step[first : first + 4], (inverse @ inverse.T)[first : first + 4, first : first + 4]
    squared = float(shape @ np.linalg.solve(covariance, shape))
    return shape if squared > SURE and (np.abs(shape) > WORTH).any() else None
