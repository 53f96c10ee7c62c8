"""Still or not, of samples with the noise of encoders."""

import numpy as np
import pytest

from koala3d.capture.drivers.ur.settling import Settling, Window, noise_of
from koala3d.capture.sim.controller.motions.arm import RINGING_DECAY_S, RINGING_HZ
from koala3d.capture.sim.controller.process import ENCODER_NOISE_RAD

RATE_HZ = 500.0
SETTLING = Settling()
RNG = np.random.default_rng(0)


def _still_after(angles_of, seconds: float = 3.0, noise: float = 0.0) -> float:
    """When samples of `angles_of(time)` count as still [s]; infinite: never."""
    window = Window(SETTLING.time_s)
    for moment in np.arange(0.0, seconds, 1 / RATE_HZ):
        window.add(100 + moment, angles_of(moment))
        if window.rests(SETTLING.spread, noise):
            return float(moment)
    return np.inf


@pytest.mark.parametrize("noise", [1e-6, ENCODER_NOISE_RAD, 9e-6, 1.1e-5, 2e-5, 4e-5])
def test_a_resting_arm_is_still_after_one_window_however_noisy_its_encoders_are(noise):
    measured = noise_of(RNG.normal(0, noise, (150, 6)))
    assert measured == pytest.approx(noise, rel=0.25)
    times = [_still_after(lambda moment: RNG.normal(0, noise, 6), noise=measured) for _ in range(20)]
    assert max(times) < 2 * SETTLING.time_s and np.median(times) == pytest.approx(SETTLING.time_s, abs=2 / RATE_HZ)


@pytest.mark.parametrize("noise", [1e-6, ENCODER_NOISE_RAD, 4e-5])
def test_a_vibration_is_waited_for_until_it_has_decayed(noise):
    """0.2 mrad at 8 Hz, which loses a factor e in half a second: still once its amplitude in a window is that of the limit."""

    def swings(moment):
        return 2e-4 * np.exp(-moment / 0.5) * np.sin(2 * np.pi * 8 * moment) + RNG.normal(0, noise, 6)

    still = _still_after(swings, noise=noise)
    amplitude = 2e-4 * np.exp(-(still - SETTLING.time_s) / 0.5)  # at the beginning of the window
    allowed = np.sqrt(2 * (noise**2 * 4 * np.sqrt(2 / 49) + SETTLING.spread**2 / 8))
    assert still > 0.6 and amplitude < 1.5 * allowed  # over a third of the window the swing decays by a fifth


def test_slow_motions_are_no_noise():
    moments = np.arange(0, 0.3, 1 / RATE_HZ)[:, None]
    angles = 5e-5 * np.sin(2 * np.pi * 2 * moments) + RNG.normal(0, 4e-6, (len(moments), 6))
    assert noise_of(angles) == pytest.approx(4e-6, rel=0.3) and noise_of(angles[:1]) == 0.0


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
    assert window.full and len(window._samples) in (4, 5)
    np.testing.assert_allclose(window.mean, 99.75, atol=0.051)
    assert Window(0.0).full is False and Window(0.0).rests(1.0, 0.0) is False
