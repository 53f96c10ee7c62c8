"""The capsules of the arm: one chain, moved by the joints that carry them."""

import itertools

import numpy as np
import pytest

from capture.planning.arm_shape import INDEX, PARTS, RADII, segments
from datasets import pose

MOUNT = pose.from_rotation_vector([np.radians(45), 0, 0], [0, 0.06, 0.08])
JOINTS = np.array([0.3, -1.2, 1.5, -0.4, -1.5, 0.2])


def test_parts_are_named_once_and_avoid_parts_that_exist() -> None:
    names = [part.name for part in PARTS]
    assert len(set(names)) == len(names) == len(RADII) and [INDEX[name] for name in names] == list(range(len(PARTS)))
    for index, part in enumerate(PARTS):
        below = [INDEX[other] for other in part.avoids]
        assert all(other < index - 1 for other in below), f"{part.name} and its neighbours always touch"


def test_the_parts_from_the_base_to_the_bracket_form_a_chain() -> None:
    ends = segments(JOINTS, MOUNT)
    for before, after in itertools.pairwise(PARTS[:-1]):
        gap = np.linalg.norm(ends[INDEX[before.name], 1] - ends[INDEX[after.name], 0])
        assert gap <= (0.007 + 1e-9 if before.name == "forearm" else 1e-9)  # the wrist is on the Denavit-Hartenberg line


@pytest.mark.parametrize(
    ("joint", "moved"),
    [(5, {"bracket", "camera"}), (4, {"wrist 3", "bracket", "camera"}), (3, {"wrist 2", "wrist 3", "bracket", "camera"})],
)
def test_a_wrist_joint_moves_what_is_behind_it(joint: int, moved: set[str]) -> None:
    turned = JOINTS.copy()
    turned[joint] += 0.5
    change = np.abs(segments(turned, MOUNT) - segments(JOINTS, MOUNT)).max((-1, -2))
    assert {part.name for part in PARTS if change[INDEX[part.name]] > 1e-9} == moved


def test_the_base_joint_turns_all_of_the_arm_but_the_base() -> None:
    ends = segments(JOINTS, MOUNT)
    turned = segments(JOINTS + 0.7 * np.eye(6)[0], MOUNT)
    rotation = pose.from_rotation_vector([0, 0, 0.7])[:3, :3]
    np.testing.assert_allclose(turned, ends @ rotation.T, atol=1e-12)
    np.testing.assert_allclose(turned[INDEX["base"]], ends[INDEX["base"]], atol=1e-12)


def test_the_camera_lies_along_its_view_axis() -> None:
    back, lens = segments(JOINTS, MOUNT)[INDEX["camera"]]
    centre = segments(JOINTS, MOUNT)[INDEX["bracket"], 1]
    assert np.linalg.norm(lens - back) == pytest.approx(0.06) and np.linalg.norm(centre - back) == pytest.approx(0.04)


def test_many_configurations_at_once_are_each_by_itself() -> None:
    many = JOINTS + np.random.default_rng(0).normal(size=(4, 3, 6))
    np.testing.assert_array_equal(segments(many, MOUNT)[2, 1], segments(many[2, 1], MOUNT))
