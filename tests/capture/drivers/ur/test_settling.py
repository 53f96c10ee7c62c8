"""Still or not, of samples with the noise of encoders."""

import numpy as np
import pytest

from koala3d.capture.drivers.ur.settling import Settling, Window
from koala3d.capture.sim.controller.motions.arm import RINGING_DECAY_S, RINGING_HZ
from koala3d.capture.sim.controller.process import ENCODER_NOISE_RAD

RATE_HZ = 500.0
SETTLING = Settling()
RNG = np.random.default_rng(0)


def _still_after(angles_of, seconds: float = 3.0) -> float:
    """When samples of `angles_of(time)` count as still [s]; infinite: never."""
    window = Window(SETTLING.time_s)
    for moment in np.arange(0.0, seconds, 1 / RATE_HZ):
        window.add(100 + moment, angles_of(moment))
        if window.full and window.spread <= SETTLING.spread:
            return float(moment)
    return np.inf


def test_a_resting_arm_with_noisy_encoders_is_still_after_one_window():
    assert _still_after(lambda moment: RNG.normal(0, ENCODER_NOISE_RAD, 6)) == pytest.approx(SETTLING.time_s, abs=2 / RATE_HZ)


def test_speeds_at_single_moments_would_never_let_that_arm_rest():
    """The premise: differences of noisy angles 4 ms apart exceed 0.001 rad/s somewhere in every window."""
    speeds = RNG.normal(0, ENCODER_NOISE_RAD, (10_000, 6)) / 0.004
    longest = np.diff(np.flatnonzero((np.abs(speeds) > 1e-3).any(axis=1))).max() / RATE_HZ
    assert longest < SETTLING.time_s


def test_a_ringing_arm_is_waited_for_and_so_is_one_that_creeps():
    def ringing(moment):
        return 2e-4 * np.exp(-moment / RINGING_DECAY_S) * np.sin(2 * np.pi * RINGING_HZ * moment) * np.ones(6)

    assert SETTLING.time_s + 0.08 < _still_after(ringing) < SETTLING.time_s + 0.2
    # 1e-3 rad/s would have passed as still; the flange moves by a quarter of a millimetre within a window
    assert _still_after(lambda moment: np.array([0, 0, 0.9e-3 * moment, 0, 0, 0])) == np.inf


def test_the_turning_point_of_a_slow_swing_is_not_rest():
    assert _still_after(lambda moment: 5e-5 * np.cos(2 * np.pi * 2.0 * moment) * np.ones(6)) == np.inf


def test_the_window_keeps_no_more_than_it_needs():
    window = Window(0.3)
    for moment in np.arange(0, 100, 0.1):
        window.add(moment, np.full(6, moment))
    assert window.full and 0.3 <= window.spread < 0.41
    np.testing.assert_allclose(window.mean, 99.9 - window.spread / 2)
    assert Window(0.0).full is False
