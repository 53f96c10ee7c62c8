"""The simulated arm without a controller keeps the contract of a robot."""

from collections.abc import Iterator

import numpy as np
import pytest

from koala3d.capture.drivers.errors import MotionError, RigConnectionError, SafetyError, StopLatched
from koala3d.capture.model.arm import load_arm
from koala3d.capture.sim.kinematic_arm import KinematicArm
from koala3d.datasets import pose
from tests.moments import as_soon_as, until

PANDA = load_arm("panda")
GOAL = PANDA.home + np.array([0.3, 0.1, -0.2, 0.2, 0.1, -0.2, 0.4])


@pytest.fixture
def robot() -> Iterator[KinematicArm]:
    with KinematicArm(PANDA, time_scale=50.0, seed=1) as opened:
        yield opened


def test_it_arrives_and_reports_where_it_is(robot: KinematicArm) -> None:
    robot.move_to(GOAL, speed=1.0, acceleration=2.0)
    state = robot.state()
    np.testing.assert_allclose(state.joints, GOAL, atol=1e-4)
    distance, angle = pose.difference(state.base_from_flange, PANDA.forward(GOAL))
    assert 1e-5 < distance < 6e-3 and angle < 0.02, "its links are as built"
    off, _ = pose.difference(robot.true_base_from_flange(), state.base_from_flange)
    assert 0 < off < 3e-4, "it stops where it repeats to"
    assert robot.exposed(0.01, 5).shape == (5, 4, 4)


def test_a_motion_takes_its_time_on_the_arms_clock(robot: KinematicArm) -> None:
    before = robot.state().robot_time_s
    robot.move_to(GOAL, speed=0.5, acceleration=2.0)
    assert robot.state().robot_time_s - before > 0.4 / 0.5 + 0.25  # travel of the fastest joint, and half a second of ramps


@pytest.mark.parametrize(
    ("target", "speed", "words"),
    [(np.zeros(6), 1.0, "not 7 finite"), (np.zeros(7), 1.0, "joint 4 would leave its range"), (GOAL, 2.5, "speed is outside")],
)
def test_what_it_cannot_do_is_refused_before_it_moves(robot: KinematicArm, target: np.ndarray, speed: float, words: str) -> None:
    before = robot.state().joints
    with pytest.raises(SafetyError, match=words):
        robot.move_to(target, speed=speed, acceleration=1.0)
    np.testing.assert_array_equal(robot.state().joints, before)


def test_a_stop_ends_the_motion_and_stays() -> None:
    with KinematicArm(PANDA, time_scale=1.0) as robot:
        with as_soon_as(lambda: np.abs(robot.state().joint_speeds).max() > 0.05, robot.stop, "an arm that moves"):
            with pytest.raises(MotionError, match="stopped on request"):
                robot.move_to(GOAL, speed=0.1, acceleration=1.0)
        until(lambda: not robot.state().joint_speeds.any(), "an arm that neither slows down nor swings")
        rest = robot.state().joints
        assert 0 < np.abs(rest - PANDA.home).max() < 0.4
        with pytest.raises(StopLatched):
            robot.move_to(GOAL, speed=0.5, acceleration=1.0)
        assert not robot.state().joint_speeds.any()
        np.testing.assert_array_equal(robot.state().joints, rest)


def test_after_a_stop_is_cleared_it_moves_again(robot: KinematicArm) -> None:
    robot.stop()
    robot.clear_stop()
    robot.move_to(GOAL, speed=1.0, acceleration=2.0)
    np.testing.assert_allclose(robot.state().joints, GOAL, atol=1e-4)


def test_outside_its_context_it_is_not_connected() -> None:
    with pytest.raises(RigConnectionError, match="not connected"):
        KinematicArm(PANDA).state()


def test_the_same_seed_is_the_same_arm() -> None:
    places = []
    for seed in (1, 1, 2):
        with KinematicArm(PANDA, time_scale=100.0, seed=seed) as robot:
            places.append(robot.state().base_from_flange)
    np.testing.assert_array_equal(places[0], places[1])
    assert np.abs(places[0] - places[2]).max() > 1e-5
