"""What an arm's pose becomes when its joints stand elsewhere than it knows."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.datasets import kinematics, pose


@pytest.fixture
def joints():
    return np.random.default_rng(0).uniform(-2, 2, (5, 6))


def test_batches_of_joint_angles_match_single_ones(joints):
    for function in (kinematics.forward, kinematics.jacobian):
        np.testing.assert_allclose(function(joints), [function(one) for one in joints], atol=1e-14)


def test_jacobian_is_the_small_motion(joints):
    step, flange = 1e-6, kinematics.forward(joints)
    for index in range(6):
        motion = pose.inverse(flange) @ kinematics.forward(joints + step * np.eye(6)[index])
        parts = np.stack([motion[:, :3, 3], pose.rotation_vector(motion)], 1) @ np.swapaxes(flange[:, :3, :3], 1, 2) / step
        np.testing.assert_allclose(
            kinematics.jacobian(joints)[..., index], parts.reshape(-1, 6), atol=2e-6
        )  # the step's own size


def test_correcting_a_nominal_arm_is_exact(joints):
    offsets = np.array([0.1, -0.2, 0.3, 0.1, -0.1, 0.2])
    found = kinematics.corrected(kinematics.forward(joints), joints, np.concatenate([np.zeros(18), offsets]))
    np.testing.assert_allclose(found, kinematics.forward(joints + offsets), atol=1e-12)
    errors = np.random.default_rng(2).normal(0, 0.01, 24)
    found = kinematics.corrected(kinematics.forward(joints), joints, errors)
    np.testing.assert_allclose(found, kinematics.forward(joints, kinematics.UR5E.with_errors(errors)), atol=1e-12)


def test_correcting_an_arm_as_built_is_accurate_to_a_hundredth(joints):
    built = kinematics.UR5E.calibrated(np.random.default_rng(1), 1e-3, 1e-3)
    offsets = np.deg2rad([0.05, -0.03, 0.04, 0.02, -0.05, 0.03])
    true, reported = (kinematics.forward(joints + turn, built) for turn in (offsets, 0))
    left, _ = pose.difference(kinematics.corrected(reported, joints, np.concatenate([np.zeros(18), offsets])), true)
    distance, _ = pose.difference(reported, true)
    assert distance.min() > 1e-4 and left.max() < 0.01 * distance.max()


def test_link_motions_are_those_of_an_arm_built_a_little_off(joints):
    step, tool = 1e-6, pose.from_rotation_vector([0.3, -0.2, 0.5], [0.01, 0.02, 0.03])
    links = replace(kinematics.UR5E, tool=tool)
    reported = kinematics.forward(joints, links)
    found = kinematics.link_motions(joints, links)
    assert found.shape == (5, 6, 24)
    for number, name in enumerate(("d", "a", "alpha", "theta")):
        for index in range(6):
            built = replace(links, **{name: getattr(links, name) + step * np.eye(6)[index]})
            motion = pose.inverse(reported) @ kinematics.forward(joints, built)
            difference = np.concatenate([motion[:, :3, 3], pose.rotation_vector(motion)], -1) / step
            np.testing.assert_allclose(found[..., 6 * number + index], difference, atol=3e-6)  # the step's own size
