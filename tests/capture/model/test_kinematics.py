"""Kinematics against the maker's parameters written out by hand, and against themselves."""

import numpy as np
import pytest

from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.datasets import pose


def _slow_forward(joints):
    """One Denavit-Hartenberg link after another, with elementary matrices."""
    lengths = [(0.1625, 0, 90), (0, -0.425, 0), (0, -0.3922, 0), (0.1333, 0, 90), (0.0997, 0, -90), (0.0996, 0, 0)]
    frame = np.eye(4)
    for angle, (d, a, alpha) in zip(joints, lengths, strict=True):
        frame = (
            frame
            @ pose.from_rotation_vector([0, 0, angle], [0, 0, d])
            @ pose.from_rotation_vector([np.radians(alpha), 0, 0], [a, 0, 0])
        )
    return frame


def test_forward_equals_the_elementary_product(rng):
    for joints in rng.uniform(-2 * np.pi, 2 * np.pi, (20, 6)):
        np.testing.assert_allclose(kinematics.forward(joints), _slow_forward(joints), atol=1e-14)


def test_known_poses():
    """At zero the arm lies along -x: |a2| + |a3| out, d4 + d6 to -y, and d1 - d5 high."""
    np.testing.assert_allclose(kinematics.forward(np.zeros(6))[:3, 3], [-0.8172, -0.2329, 0.0628], atol=1e-12)


def test_every_inverse_branch_arrives(rng):
    counts = []
    for joints in rng.uniform(-np.pi, np.pi, (100, 6)):
        target = kinematics.forward(joints)
        branches = load_arm("ur5e").inverse(target)
        counts.append(len(branches))
        np.testing.assert_allclose(kinematics.forward(branches), np.broadcast_to(target, (len(branches), 4, 4)), atol=1e-6)
        assert np.abs(kinematics.wrap(branches - joints)).max(axis=1).min() < 1e-5  # the one we came from is among them
    assert np.mean(counts) > 4


def test_no_branch_out_of_reach():
    assert load_arm("ur5e").inverse(pose.rigid(np.eye(3), [1.2, 0, 0.3])).shape == (0, 6)


def test_jacobian_equals_differences(rng):
    joints, step = rng.uniform(-2, 2, 6), 1e-6
    for index in range(6):
        moved = joints + step * np.eye(6)[index]
        before, after = kinematics.forward(joints), kinematics.forward(moved)
        linear = (after[:3, 3] - before[:3, 3]) / step
        angular = pose.rotation_vector(after[:3, :3] @ before[:3, :3].T) / step
        np.testing.assert_allclose(kinematics.jacobian(joints)[:, index], np.append(linear, angular), atol=5e-6)  # step


def test_singularity_vanishes_where_axes_align():
    straight_wrist = np.array([0.3, -1.2, 1.5, -0.4, 0.0, 0.2])
    assert kinematics.singularity(straight_wrist) < 1e-9
    assert kinematics.singularity(np.add(straight_wrist, [0, 0, 0, 0, 1.3, 0])) > 0.1


def test_nearest_turn_stays_inside_the_limits_and_changes_no_pose(rng):
    joints, reference = rng.uniform(-np.pi, np.pi, (50, 6)), rng.uniform(-6, 6, (50, 6))
    turned = kinematics.nearest_turn(joints, reference)
    assert np.abs(turned).max() <= kinematics.JOINT_LIMIT
    np.testing.assert_allclose(kinematics.forward(turned), kinematics.forward(joints), atol=1e-12)
    near = np.abs(reference) < np.pi
    assert np.abs(turned - reference)[near].max() <= np.pi + 1e-9


def test_an_arm_as_built_differs_by_millimetres(rng):
    links = kinematics.UR5E.calibrated(rng, length_m=5e-4, angle_rad=1e-3)
    joints = np.array([0.4, -1.3, 1.6, -1.8, -1.5, 0.3])
    distance, angle = pose.difference(kinematics.forward(joints, links), kinematics.forward(joints))
    assert 1e-4 < distance < 1e-2 and angle < 1e-2


@pytest.fixture
def rng():
    return np.random.default_rng(7)
