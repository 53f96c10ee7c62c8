"""The simulated arm: small errors that repeat with the seed, an oscillation that decays, and stops for safety."""

import numpy as np
import pytest

from koala3d.capture.drivers.ur.modes import SafetyMode
from koala3d.capture.model.kinematics import UR5E, forward
from koala3d.capture.sim.controller.motions.arm import PAUSE_S, SimulatedArm
from koala3d.capture.sim.controller.motions.profiles import Braking
from koala3d.datasets import pose

HOME = np.array([0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
GOAL = np.array([0.3, -1.2, 1.0, -1.4, -1.5, 0.2])


def _arm(seed=0, links=UR5E):
    return SimulatedArm(seed, HOME, repeatability_m=3e-5, repeatability_rad=1e-4, links=links)


def _visit(arm, goal, now):
    arm.move_to(goal, 1.0, 1.4, now)
    return now + arm.profile.duration + 2.0


def _error(arm, now):
    return pose.inverse(forward(arm.actual(now)[0])) @ arm.true_base_from_flange(now)


def test_the_flange_stops_beside_where_the_encoders_say():
    arm, now, errors = _arm(), 0.0, []
    for goal in np.random.default_rng(0).uniform(-1, 1, (200, 6)):
        now = _visit(arm, HOME + 0.3 * goal, now)
        errors.append(_error(arm, now)[:3, 3])
    assert np.std(errors) == pytest.approx(3e-5, rel=0.12)  # 600 draws: 2.9% standard error, four of them
    assert np.abs(np.mean(errors, axis=0)).max() < 1e-5


def test_the_same_visit_has_the_same_error_whatever_came_before():
    direct, roundabout, other = _arm(), _arm(), _arm(seed=1)
    now = _visit(roundabout, HOME + 0.1, _visit(roundabout, HOME - 0.1, 0.0))
    end, later = _visit(direct, GOAL, 0.0), _visit(roundabout, GOAL, now)
    np.testing.assert_array_equal(direct.true_base_from_flange(end), roundabout.true_base_from_flange(later))
    again = _visit(roundabout, GOAL, _visit(roundabout, HOME, later))
    assert np.abs(_error(roundabout, again) - _error(direct, end)).max() > 1e-7  # a second visit repeats, but not exactly
    assert np.abs(_error(other, _visit(other, GOAL, 0.0)) - _error(direct, end)).max() > 1e-7


def test_the_arm_swings_after_a_stop_and_comes_to_rest():
    arm = _arm()
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    end = arm.profile.duration
    just, later = arm.actual(end + 0.02), arm.actual(end + 0.5)
    assert 1e-5 < np.abs(just[0] - GOAL).max() < 1e-3 and np.abs(just[1]).max() > 1e-3
    np.testing.assert_array_equal(later[0], GOAL)
    assert not later[1].any()


def test_the_controller_knows_the_calibrated_links():
    links = UR5E.calibrated(np.random.default_rng(0), 1e-3, 1e-3)
    arm = _arm(links=links)
    now = _visit(arm, GOAL, 0.0)
    reported, true = arm.base_from_tcp(arm.actual(now)[0]), arm.true_base_from_flange(now)
    assert pose.difference(reported, true)[0] < 2e-4 < pose.difference(forward(GOAL), true)[0]


def test_an_emergency_stop_ends_the_motion_and_the_power():
    arm = _arm()
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    arm.stop_for_safety(SafetyMode.ROBOT_EMERGENCY_STOP, 0.8)
    assert isinstance(arm.profile, Braking) and arm.profile.duration < 0.2 and not arm.may_move
    assert np.abs(arm.target(5.0)[0] - GOAL).max() > 0.1


def test_a_target_beyond_the_joint_limits_is_a_protective_stop():
    arm = _arm()
    arm.move_to(np.array([7.0, 0, 0, 0, 0, 0]), 1.0, 1.0, 0.0)
    assert arm.safety is SafetyMode.PROTECTIVE_STOP and not arm.moving(0.1)


def test_the_flange_bends_after_a_stop_beyond_what_the_encoders_see():
    arm = _arm()
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    end = arm.profile.duration
    early, late = (
        pose.difference(forward(arm.actual(at)[0]), arm.true_base_from_flange(at))[0] for at in (end + 0.02, end + 0.5)
    )
    assert 2e-4 < early < 5e-3 and late < 2e-4  # late: the arm's repeatability alone


def test_the_oscillation_lasts_as_long_as_it_says():
    arm = _arm()
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    end, lasts = arm.profile.duration, arm.swings_for(arm.profile, 5e-5)
    after = np.array([arm.actual(end + lasts + step)[0] for step in np.linspace(2e-4, 0.3, 600)])
    assert 0.05 < lasts < 0.36 and np.ptp(after, axis=0).max() <= 5e-5
    before = np.array([arm.actual(end + lasts + step)[0] for step in np.linspace(-5e-3, 0.3, 600)])
    assert np.ptp(before, axis=0).max() > 5e-5


def test_encoders_have_noise_that_the_joints_have_not():
    arm = SimulatedArm(0, HOME, 0.0, 0.0, noise_rad=1e-5)
    angles, speeds = zip(*(arm.measured(1.0) for _ in range(500)), strict=True)
    np.testing.assert_array_equal(arm.actual(1.0)[0], HOME)
    assert np.std(np.subtract(angles, HOME)) == pytest.approx(1e-5, rel=0.06)  # 3000 draws: 1.3 % standard error
    assert np.std(speeds) == pytest.approx(2.5e-3, rel=0.06)


def test_the_speed_slider_stretches_a_motion_under_way():
    arm, whole = _arm(), _arm()
    for one in (arm, whole):
        one.move_to(GOAL, 1.0, 1.4, 0.0)
    arm.set_speed_slider(0.25, 0.5)
    np.testing.assert_allclose(arm.target(0.9)[0], whole.target(0.6)[0], atol=1e-12)  # 0.4 s at a quarter are 0.1 s
    np.testing.assert_allclose(arm.target(0.9)[1], 0.25 * whole.target(0.6)[1], atol=1e-12)
    assert arm.moving(whole.profile.duration + 0.1) and not arm.moving(0.5 + 4 * (whole.profile.duration - 0.5) + 1e-6)
    arm.set_speed_slider(1.0, 0.9)
    np.testing.assert_allclose(arm.target(1.0)[0], whole.target(0.7)[0], atol=1e-12)


def test_a_paused_motion_rests_on_its_path_and_is_resumed_to_its_goal():
    arm, whole = _arm(), _arm()
    for one in (arm, whole):
        one.move_to(GOAL, 1.0, 1.4, 0.0)
    arm.pause(0.6)
    assert arm.moving(0.8) and not arm.moving(0.91)
    angles, speeds, _ = arm.target(0.91)
    np.testing.assert_allclose(angles, whole.target(0.6 + PAUSE_S / 2)[0], atol=1e-12)  # evenly slower: half as far
    assert not speeds.any() and np.array_equal(arm.actual(50.0)[0], angles) and not arm.actual(50.0)[1].any()
    arm.set_speed_slider(1.0, 60.0)
    assert not arm.moving(70.0)  # the slider starts nothing
    arm.resume(80.0)
    assert arm.moving(80.0)
    np.testing.assert_allclose(arm.target(80.5)[0], whole.target(0.6 + 0.5)[0], atol=1e-12)  # twice half the ramp was lost
    np.testing.assert_array_equal(arm.target(90.0)[0], GOAL)


def test_a_paused_motion_is_forgotten_after_a_stop():
    arm = _arm()
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    arm.pause(0.6)
    arm.stop(3.0, 5.0)
    rests = arm.target(5.0)[0]
    arm.resume(6.0)
    assert not arm.moving(6.1) and np.array_equal(arm.target(10.0)[0], rests) and np.abs(rests - GOAL).max() > 0.1


def test_an_arm_at_rest_is_neither_paused_nor_resumed():
    arm = _arm()
    now = _visit(arm, GOAL, 0.0)
    arm.pause(now)
    arm.resume(now + 1)
    assert not arm.moving(now + 2) and np.array_equal(arm.target(now + 2)[0], GOAL)
    _visit(arm, HOME, now + 3)
    assert arm.moving(now + 3.1)


def test_leaving_a_narrowed_joint_range_is_a_protective_stop():
    arm = _arm()
    arm.joint_limits[1, 2] = 0.5
    arm.move_to(GOAL, 1.0, 1.4, 0.0)
    times = np.arange(0, 3, 0.002)
    stopped = next(now for now in times if arm.check_limits(now) or arm.safety is SafetyMode.PROTECTIVE_STOP)
    assert 0.5 <= arm.target(stopped + 1)[0][2] < 0.6
