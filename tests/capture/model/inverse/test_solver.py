"""Inverse kinematics of every shipped arm, by each solver, against forward kinematics."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from koala3d.capture.model.arm import ArmModel, load_arm
from koala3d.capture.model.inverse import numerical
from koala3d.capture.model.kinematics import wrap
from koala3d.datasets import pose

NAMES = ["ur3e", "ur5e", "ur10e", "ur16e", "ur7e", "ur15", "ur20", "ur30", "panda"]


def angles_of(arm: ArmModel, shares: list[float]) -> np.ndarray:
    """(n,) angles [rad] at shares 0..1 of each joint's range, at most half a turn to either side."""
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    return low + np.array(shares[: arm.count]) * (high - low)


@pytest.mark.parametrize("name", NAMES)
@given(shares=st.lists(st.floats(0, 1), min_size=7, max_size=7))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_every_branch_reaches_the_pose(name: str, shares: list[float]) -> None:
    arm = load_arm(name)
    target = arm.forward(angles_of(arm, shares))
    branches = arm.inverse(target)
    distance, angle = pose.difference(arm.forward(branches), target)
    assert (distance < 1e-6).all() and (angle < 1e-6).all() and (np.abs(branches) <= np.pi).all()


@pytest.mark.parametrize("name", NAMES[:-1])
def test_the_configuration_that_we_came_from_is_among_the_branches(name: str) -> None:
    arm, rng = load_arm(name), np.random.default_rng(3)
    for _ in range(50):
        joints = rng.uniform(-np.pi, np.pi, 6)
        branches = arm.inverse(arm.forward(joints))
        assert np.abs(wrap(branches - joints)).max(axis=1).min() < 1e-5


@pytest.mark.skipif(load_arm("panda").solver != "eaik", reason="EAIK is not installed: it has no wheel for this Python")
def test_an_arm_with_seven_joints_reaches_every_pose_in_many_ways() -> None:
    """A few poses at the edge of its reach have solutions only between the angles at which a joint is held."""
    arm, rng, counts = load_arm("panda"), np.random.default_rng(4), []
    for _ in range(50):
        joints = angles_of(arm, list(rng.uniform(0.05, 0.95, 7)))
        branches = arm.inverse(arm.forward(joints))
        inside = branches[arm.inside(branches)]
        counts.append(len(branches))
        assert len(inside) > 0
    assert np.median(counts) > 10


@pytest.mark.parametrize("name", NAMES)
def test_iteration_finds_what_decomposition_finds(name: str) -> None:
    arm, rng = load_arm(name), np.random.default_rng(5)
    for _ in range(4):
        joints = angles_of(arm, list(rng.uniform(0.1, 0.9, 7)))
        target = arm.forward(joints)
        found = numerical.solutions(target, arm.links, arm.lower, arm.upper)
        distance, angle = pose.difference(arm.forward(found), target)
        assert len(found) >= 1 and (distance < 1e-7).all() and (angle < 1e-6).all() and arm.inside(found).all()
        if arm.count == 6:
            nearest = [np.abs(wrap(arm.inverse(target) - one)).max(axis=1).min() for one in found]
            assert max(nearest) < 1e-5, "no solution that the closed form does not know"


def test_iteration_says_that_a_pose_is_out_of_reach() -> None:
    arm = load_arm("panda")
    assert numerical.solutions(pose.rigid(np.eye(3), [1.4, 0, 0.3]), arm.links, arm.lower, arm.upper).shape == (0, 7)
    assert arm.inverse(pose.rigid(np.eye(3), [1.4, 0, 0.3])).shape == (0, 7)


def test_without_the_library_an_arm_with_seven_joints_is_solved_by_iteration(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "eaik.IK_DH", None)  # importing it fails, as where it is missing
    load_arm.cache_clear()
    try:
        arm = load_arm("panda")
        target = arm.forward(arm.home)
        assert arm.solver == "numerical"
        found = arm.forward(arm.inverse(target))
        assert len(found) > 5
        np.testing.assert_allclose(found, np.broadcast_to(target, found.shape), atol=1e-6)
    finally:
        load_arm.cache_clear()
