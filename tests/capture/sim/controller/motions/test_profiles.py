"""Motions keep their limits, join smoothly and arrive."""

import numpy as np
import pytest

from koala3d.capture.sim.controller.motions.profiles import Braking, Chain, Move, trapezoid_times

START, GOAL = np.zeros(6), np.array([1.2, -0.6, 0.3, 0, 0, 0.1])


def _sampled(profile, count=4001):
    times = np.linspace(0, profile.duration, count)
    angles, speeds, _ = (np.array(part) for part in zip(*(profile.at(time) for time in times), strict=True))
    return times, angles, speeds


@pytest.mark.parametrize("speed", [0.5, 5.0])  # with and without a cruise
def test_a_move_keeps_its_limits_and_arrives(speed):
    move = Move(START, GOAL, speed, 1.5)
    times, angles, speeds = _sampled(move)
    assert np.abs(speeds).max() <= speed + 1e-9
    assert np.abs(np.diff(speeds, axis=0)).max() <= 1.5 * times[1] * (1 + 1e-6)
    np.testing.assert_allclose(
        np.gradient(angles, times, axis=0)[1:-1], speeds[1:-1], atol=2e-3
    )  # central difference at the kinks
    np.testing.assert_array_equal(move.at(np.inf)[0], GOAL)
    np.testing.assert_allclose(angles[:, 0] * GOAL[1], angles[:, 1] * GOAL[0], atol=1e-12)  # all joints in proportion


def test_trapezoid_by_hand():
    """2 rad at 1 rad/s and 2 rad/s^2: ramps of 0.5 s cover 0.25 rad each, 1.5 s of cruise the rest."""
    assert trapezoid_times(2.0, 1.0, 2.0) == pytest.approx((0.5, 1.5))
    assert trapezoid_times(0.0, 1.0, 2.0) == (0.0, 0.0)


def test_a_stop_brakes_the_fastest_joint_as_asked():
    stop = Braking(START, np.array([1.0, -0.5, 0, 0, 0, 0]), 2.0)
    assert stop.duration == 0.5
    np.testing.assert_allclose(stop.at(np.inf)[0], [0.25, -0.125, 0, 0, 0, 0])
    assert not stop.at(0.6)[1].any()


def test_a_chain_is_continuous():
    stop = Braking(START, np.array([1.0, 0, 0, 0, 0, 0]), 2.0)
    chain = Chain(stop, Move(stop.at(np.inf)[0], GOAL, 1.0, 2.0))
    _, angles, speeds = _sampled(chain)
    assert np.abs(np.diff(angles, axis=0)).max() < 1e-3 and np.abs(np.diff(speeds, axis=0)).max() < 2e-3
    np.testing.assert_allclose(angles[-1], GOAL)
