"""The capsules of an arm and its camera: one chain, moved by the joints that carry them."""

import itertools

import numpy as np
import pytest

from koala3d.capture.model.rig import RigDescription
from koala3d.datasets import pose

MOUNT = RigDescription().carrier()
PARTS, INDEX = MOUNT.shape.parts, MOUNT.shape.index
JOINTS = np.array([0.3, -1.2, 1.5, -0.4, -1.5, 0.2])


def test_the_camera_is_checked_against_every_link_but_its_own() -> None:
    pairs = {(PARTS[a].name, PARTS[b].name) for a, b in MOUNT.shape.pairs}
    links = ["base", "shoulder", "upper arm", "elbow", "forearm", "wrist 1", "wrist 2"]
    for part in ("lens", "camera", "plug"):
        assert {(part, link) for link in links} <= pairs and (part, "wrist 3") not in pairs and (part, "bracket") not in pairs
    assert {("wrist 3", "forearm"), ("bracket", "forearm"), ("wrist 1", "shoulder")} <= pairs
    assert not {("wrist 3", "wrist 1"), ("forearm", "shoulder"), ("bracket", "wrist 1")} & pairs, "neighbours always touch"


def test_the_parts_from_the_base_to_the_bracket_form_a_chain() -> None:
    ends = MOUNT.segments(JOINTS)
    for before, after in itertools.pairwise([*MOUNT.arm.parts, PARTS[INDEX["bracket"]]]):
        gap = np.linalg.norm(ends[INDEX[before.name], 1] - ends[INDEX[after.name], 0])
        assert gap <= (0.007 + 1e-9 if before.name == "forearm" else 1e-9)  # the wrist is on the Denavit-Hartenberg line


@pytest.mark.parametrize(("joint", "first"), [(5, "wrist 3"), (4, "wrist 2"), (3, "wrist 1")])
def test_a_wrist_joint_moves_what_is_behind_it(joint: int, first: str) -> None:
    turned = JOINTS.copy()
    turned[joint] += 0.5
    change = np.abs(MOUNT.segments(turned) - MOUNT.segments(JOINTS)).max((-1, -2))
    moved = {part.name for part in PARTS if change[INDEX[part.name]] > 1e-9}
    assert moved == {part.name for part in PARTS[INDEX[first] + 1 :]}, "what lies along the joint's axis stays"


def test_the_base_joint_turns_all_of_the_arm_but_the_base() -> None:
    ends = MOUNT.segments(JOINTS)
    turned = MOUNT.segments(JOINTS + 0.7 * np.eye(6)[0])
    rotation = pose.from_rotation_vector([0, 0, 0.7])[:3, :3]
    np.testing.assert_allclose(turned, ends @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(turned[INDEX["base"]], ends[INDEX["base"]], atol=1e-12)


def test_the_camera_lies_along_its_view_axis() -> None:
    """A lens of 25 mm ends 33 mm before its projection centre, and the plug 100 mm behind it."""
    ends, view = MOUNT.segments(JOINTS), MOUNT.base_from_camera(JOINTS)
    for name, front, back in (("lens", 0.033, -0.025), ("plug", -0.035, -0.1)):
        along = (ends[INDEX[name]] - view[:3, 3]) @ view[:3, 2]
        assert along[0] + PARTS[INDEX[name]].radius == pytest.approx(front) and along[1] - PARTS[
            INDEX[name]
        ].radius == pytest.approx(back)


def test_many_configurations_at_once_are_each_by_itself() -> None:
    many = JOINTS + np.random.default_rng(0).normal(size=(4, 3, 6))
    np.testing.assert_allclose(MOUNT.segments(many)[2, 1], MOUNT.segments(many[2, 1]), atol=1e-12)
