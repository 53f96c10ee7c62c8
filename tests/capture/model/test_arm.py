"""Which arm it is, by what it reports."""

import numpy as np
import pytest

from koala3d.capture.model.arm import identify, load_arm, recorded_arm, shipped_arms
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import UR5E, forward
from koala3d.datasets.recording import Recording

NAMES = ["UR10e", "UR15", "UR16e", "UR20", "UR30", "UR3e", "UR5e"]
TWIN = "UR7e"
"""Has the links of the UR5e."""
OTHERS = ["Franka Panda"]


def test_the_shipped_arms_are_there_and_the_ur5e_is_the_one_that_everything_else_uses():
    assert sorted(model.name for model in shipped_arms()) == [*OTHERS, *NAMES, TWIN]
    links = load_arm("ur5e").links
    for part in ("d", "a", "alpha", "theta"):
        np.testing.assert_allclose(getattr(links, part), getattr(UR5E, part), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_as_built_is_told_apart_in_any_pose(name):
    rng = np.random.default_rng(0)
    links = load_arm(name.lower()).links.calibrated(rng, 5e-4, 1e-3)
    for joints in rng.uniform(-np.pi, np.pi, (200, 6)):
        joints[2] *= 0.85  # with the elbow folded flat, which no arm can, a UR20 reaches as far as a UR30
        found = identify(joints, forward(joints, links))
        assert found.model.name == name and found.certain, joints
        assert found.may_be(load_arm(name.lower())) and found.may_be(load_arm(TWIN.lower())) == (name == "UR5e")


def test_two_models_with_the_same_links_cannot_be_told_apart():
    joints, arm = np.array([0.2, -1.4, 0.9, -1.5, -1.5, 0.2]), load_arm("ur7e")
    found = identify(joints, arm.forward(joints))
    assert found.model.name == "UR5e" and found.may_be(arm) and not found.may_be(load_arm("ur10e"))


def test_an_arm_that_is_none_of_them_is_not_certain():
    joints = np.array([0.2, -1.4, 0.9, -1.5, -1.5, 0.2])
    other = load_arm("ur10e").links
    longer = type(other)(other.d, 1.5 * other.a, other.alpha, other.theta)
    assert not identify(joints, forward(joints, longer)).certain


@pytest.mark.parametrize(
    ("name", "position"),
    [
        ("ur3e", [-0.45675, -0.22315, 0.0665]),
        ("ur10e", [-1.18425, -0.2907, 0.06085]),
        ("ur16e", [-0.8384, -0.2907, 0.06085]),
        ("ur7e", [-0.8172, -0.2329, 0.0628]),
        ("ur15", [-1.1639, -0.3258, 0.0825]),
        ("ur20", [-1.5907, -0.3553, 0.077]),
        ("ur30", [-1.1407, -0.3553, 0.077]),
    ],
)
def test_the_flange_at_zero_angles_is_where_the_lengths_put_it(name, position):
    """The arm lies along -x: a2 + a3 out, d4 + d6 to -y, and d1 - d5 high."""
    np.testing.assert_allclose(load_arm(name).forward(np.zeros(6))[:3, 3], position, atol=1e-12)


def test_an_arm_with_seven_joints_is_told_apart_too():
    arm, rng = load_arm("panda"), np.random.default_rng(1)
    for joints in rng.uniform(arm.lower, arm.upper, (20, 7)):
        found = identify(joints, forward(joints, arm.links.calibrated(rng, 5e-4, 1e-3)))
        assert found.model.name == "Franka Panda" and found.certain


def test_speeds_and_limits_are_the_makers():
    panda, ur10e = load_arm("panda"), load_arm("ur10e")
    np.testing.assert_allclose(panda.upper, [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973], atol=1e-9)
    np.testing.assert_allclose(panda.speed, [2.175] * 4 + [2.61] * 3, atol=1e-9)
    np.testing.assert_allclose(np.degrees(ur10e.speed), [120, 120, 180, 180, 180, 180])
    np.testing.assert_allclose(np.degrees(load_arm("ur15").speed), [180, 180, 240, 300, 300, 300])
    for name in ("ur20", "ur30"):
        np.testing.assert_allclose(np.degrees(load_arm(name).speed), [120, 120, 150, 210, 210, 210])
    assert panda.inside(panda.home) and not panda.inside(np.zeros(7)), "the fourth joint cannot reach zero"


def test_the_wrist_is_never_farther_than_its_reach():
    for name in ("ur3e", "ur10e", "ur20", "panda"):
        arm = load_arm(name)
        joints = np.random.default_rng(2).uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (2000, arm.count))
        distances = [arm.wrist_distance(flange) for flange in arm.forward(joints)]
        assert 0.9 * arm.reach < max(distances) < 1.02 * arm.reach


FILE = """\
format: koala-arm
version: 1
name: Two
dh: {d: [0.1, 0.0], a: [0.2, 0.3], alpha_deg: [0, 0]}
limits: {lower_deg: [-90, -90], upper_deg: [90, 90], speed_deg: [10, 10], acceleration_deg: [10, 10]}
home_deg: [0, 0]
capsules: [{name: arm, link: 1, start: [-0.2, 0, 0], end: [0, 0, 0], radius: 0.02}]
"""


def test_an_arm_of_ones_own(tmp_path):
    (tmp_path / "two.yaml").write_text(FILE)
    arm = load_arm(tmp_path / "two.yaml")
    assert arm.count == 2 and arm.solver == "numerical"
    np.testing.assert_allclose(arm.forward([np.pi / 2, 0.0])[:3, 3], [0, 0.5, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("home_deg: [0, 0]", "home_deg: [0]", "home_deg has 1 numbers, but dh.d gives the arm 2 joints"),
        ("speed_deg: [10, 10]", "speed_deg: [10, 0]", "speeds and accelerations positive"),
        ("lower_deg: [-90, -90]", "lower_deg: [-90, 90]", "lower must be below upper"),
        ("speed_deg: [10, 10], ", "", "limits.speed_deg is missing"),
        ("link: 1", "link: 3", "a link has a number above 2"),
        ("dh: {d: [0.1, 0.0], a: [0.2, 0.3], alpha_deg: [0, 0]}", "", "give either dh or urdf"),
        ("a: [0.2, 0.3]", "a: [0.2, 0.3, 0.4]", "dh.a has 3 numbers"),
        ("radius: 0.02", "radius: 0", "greater than 0"),
        ("radius: 0.02", "radios: 0.02", "unknown key 'capsules.0.radios'"),
    ],
)
def test_a_wrong_arm_file_is_one_clear_line(tmp_path, old, new, words):
    assert old in FILE
    (tmp_path / "two.yaml").write_text(FILE.replace(old, new))
    with pytest.raises(UsageError, match=words):
        load_arm(tmp_path / "two.yaml")


def test_an_arm_in_a_recording_comes_back(tmp_path):
    for name in ("ur10e", "panda"):
        arm = load_arm(name)
        recording = Recording.create(tmp_path / name, {"arm": arm.model_dump(mode="json")})
        again = recorded_arm(Recording.open(recording.path))
        assert again == arm
        np.testing.assert_array_equal(again.forward(arm.home), arm.forward(arm.home))
        np.testing.assert_allclose(forward(arm.home, Recording.open(recording.path).links), arm.forward(arm.home), atol=1e-15)
