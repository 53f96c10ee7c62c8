"""Which arm it is, by what it reports."""

import numpy as np
import pytest

from capture.arm_model import identify, load_arm, shipped_arms
from datasets.kinematics import UR5E, forward

NAMES = ["UR10e", "UR16e", "UR3e", "UR5e"]


def test_the_shipped_arms_are_there_and_the_ur5e_is_the_one_that_everything_else_uses():
    assert sorted(model.name for model in shipped_arms()) == NAMES
    links = load_arm("ur5e").links
    for part in ("d", "a", "alpha", "theta"):
        np.testing.assert_allclose(getattr(links, part), getattr(UR5E, part), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_as_built_is_told_apart_in_any_pose(name):
    rng = np.random.default_rng(0)
    links = load_arm(name.lower()).links.calibrated(rng, 5e-4, 1e-3)
    for joints in rng.uniform(-np.pi, np.pi, (200, 6)):
        found = identify(joints, forward(joints, links))
        assert found.model.name == name and found.certain, joints


def test_an_arm_that_is_none_of_them_is_not_certain():
    joints = np.array([0.2, -1.4, 0.9, -1.5, -1.5, 0.2])
    other = load_arm("ur10e").links
    longer = type(other)(other.d, 1.5 * other.a, other.alpha, other.theta)
    assert not identify(joints, forward(joints, longer)).certain
