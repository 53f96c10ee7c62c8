"""Whether the stated 95 % region holds the truth in 95 of 100 sessions."""

import numpy as np
import pytest
from scipy.stats import chi2

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import ARM, SIGMA_PX, simulate, target_session
from koala3d.datasets import pose
from tests.bench.handeye import ESTIMATED, RIG


def inside(truth, stated):
    """Whether the truth is in the 95 % region of an uncertain pose."""
    perturbation = truth @ pose.inverse(stated.matrix)
    error = np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])
    return error @ np.linalg.solve(stated.covariance, error) < chi2.ppf(0.95, 6)


def draw(seed, views):
    rng = np.random.default_rng([9, seed, views])
    return simulate(rng, RIG, viewpoints(rng, RIG, views, ViewRange()), sigma_px=SIGMA_PX, arm=ARM, free=ESTIMATED)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("views", [12, 25])
def test_coverage_of_two_hundred_sessions_that_go_the_whole_way(views):
    """Intrinsics with a lens chosen by the data, closed form, outliers, refinement: as `calib handeye` does it."""
    held = []
    for seed in range(200):
        simulated = draw(seed, views)
        found = calibrate.calibrate_handeye(target_session(simulated), accuracy=ARM)
        held.append(inside(simulated.truth.mount_from_camera, found.flange_from_camera))
    assert 0.93 <= np.mean(held) <= 0.97, np.mean(held)
