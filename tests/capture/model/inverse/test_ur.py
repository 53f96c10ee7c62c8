"""The closed form of our own against EAIK, and both against forward kinematics."""

import sys

import numpy as np
import pytest

from koala3d.capture.model import kinematics
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.inverse import ur
from koala3d.capture.model.rig import RigDescription
from koala3d.capture.model.trajectory import load_trajectory
from koala3d.capture.planning import plan
from koala3d.datasets import pose


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.fixture
def use(monkeypatch):
    """Makes a UR5e use a solver; skips where it is not installed."""

    def choose(name):
        monkeypatch.undo()
        if name == "eaik":
            pytest.importorskip("eaik.IK_DH", reason="EAIK is not installed: it has no wheel for this Python and platform")
        else:
            monkeypatch.setitem(sys.modules, "eaik.IK_DH", None)  # importing it fails, as where it is missing
        load_arm.cache_clear()

    yield choose
    load_arm.cache_clear()


def _inverse_of(use, name, targets):
    use(name)
    arm = load_arm("ur5e")
    return [arm.inverse(target) for target in targets]


@pytest.mark.parametrize("name", ["eaik", "own"])
def test_branches_arrive_and_include_the_one_we_came_from(use, rng, name):
    joints = rng.uniform(-np.pi, np.pi, (200, 6))
    targets = kinematics.forward(joints)
    for angles, target, branches in zip(joints, targets, _inverse_of(use, name, targets), strict=True):
        distance, angle = pose.difference(kinematics.forward(branches), target)
        assert distance.max() < 1e-9 and angle.max() < 1e-7  # the angle comes from an arc cosine
        assert np.abs(kinematics.wrap(branches - angles)).max(axis=1).min() < 1e-7


def test_the_solver_is_chosen_by_what_is_installed(use):
    use("own")
    assert load_arm("ur5e").solver == "ur" and load_arm("panda").solver == "numerical"
    use("eaik")
    assert load_arm("ur5e").solver == load_arm("panda").solver == "eaik"


def test_both_solvers_find_the_same_branches_in_the_same_order(use, rng):
    targets = kinematics.forward(rng.uniform(-np.pi, np.pi, (2000, 6)))
    pairs = zip(_inverse_of(use, "own", targets), _inverse_of(use, "eaik", targets), strict=True)
    pairs = [(own, eaik) for own, eaik in pairs if not (len(own) and np.abs(np.sin(own[:, [2, 4]])).min() < 1e-4)]
    assert len(pairs) > 1950  # the others are next to a singularity, which has a test of its own
    for own, eaik in pairs:
        assert own.shape == eaik.shape
        np.testing.assert_allclose(kinematics.wrap(own - eaik), 0, atol=1e-9)  # measured 4e-11


@pytest.mark.parametrize(("joint", "name"), [(2, "stretched elbow"), (4, "straight wrist")])
@pytest.mark.parametrize("angle", [1e-3, -1e-5])
def test_next_to_a_singularity_both_still_agree(use, rng, joint, name, angle):
    joints = rng.uniform(-np.pi, np.pi, (200, 6))
    joints[:, joint] = angle
    targets = kinematics.forward(joints)
    assert max(kinematics.singularity(q) for q in joints) < 1e-2, f"premise: {name}"
    for own, eaik in zip(_inverse_of(use, "own", targets), _inverse_of(use, "eaik", targets), strict=True):
        assert own.shape == eaik.shape
        np.testing.assert_allclose(kinematics.wrap(own - eaik), 0, atol=1e-6)  # measured 4e-8


@pytest.mark.parametrize(("joint", "share"), [(2, 1.0), (4, 0.7)])
def test_at_a_singularity_what_is_found_arrives(use, rng, joint, share):
    """With a straight wrist q6 is chosen as 0, for which the elbow may be out of reach."""
    joints = rng.uniform(-np.pi, np.pi, (100, 6))
    joints[:, joint] = 0.0
    targets = kinematics.forward(joints)
    found = _inverse_of(use, "own", targets)
    assert np.mean([len(branches) > 0 for branches in found]) >= share
    for target, branches in zip(targets, found, strict=True):
        distance, angle = pose.difference(kinematics.forward(branches), target)
        assert (distance < 1e-6).all() and (angle < 1e-6).all()


SYMMETRIC = """\
format: koala-trajectory
version: 1
name: symmetric
up: -z
views:
  - {kind: orbit, target: [0, 0, 1.1], distance: 1.0, elevation_deg: 40, azimuth_deg: [60, 240], count: 3, roll_deg: [0, 180]}
safety: {table_z: 1.2, ceiling_z: 0.0}
object: {centre: [0, 0, 1.1], size: [0.2, 0.2, 0.2]}
"""
"""An arm and views that are their own mirror image: two plans cost the same."""


def test_the_choice_between_equal_plans_does_not_depend_on_the_solver(use, tmp_path):
    (tmp_path / "symmetric.yaml").write_text(SYMMETRIC)
    trajectory, mount = load_trajectory(tmp_path / "symmetric.yaml"), RigDescription().carrier()
    joints = []
    for name in ("own", "eaik"):
        use(name)
        joints.append(np.stack([view.joints for view in plan(trajectory, mount)]))
    np.testing.assert_allclose(joints[0], joints[1], atol=1e-9)


@pytest.mark.parametrize("position", [[1.2, 0, 0.3], [0, 0, 0.5], [0.05, 0.05, 0.4]])
def test_out_of_reach_and_inside_the_column_have_no_branch(position):
    assert ur.branches(pose.rigid(np.eye(3), position), kinematics.UR5E).shape == (0, 6)


def test_another_arm_of_the_family(rng):
    """The maker's parameters of the UR10e; only the lengths differ."""
    ur10e = kinematics.Links(
        d=np.array([0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655]),
        a=np.array([0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0]),
        alpha=kinematics.UR5E.alpha,
        theta=np.zeros(6),
    )
    for joints in rng.uniform(-np.pi, np.pi, (50, 6)):
        target = kinematics.forward(joints, ur10e)
        branches = ur.branches(target, ur10e)
        np.testing.assert_allclose(kinematics.forward(branches, ur10e), np.broadcast_to(target, (len(branches), 4, 4)), atol=1e-9)
        assert np.abs(kinematics.wrap(branches - joints)).max(axis=1).min() < 1e-7
