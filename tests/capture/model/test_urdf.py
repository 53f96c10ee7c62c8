"""The chain of a URDF as Denavit-Hartenberg parameters, against the product of its own transforms."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from koala3d import configs
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.urdf import from_axes, read_chain
from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.kinematics import forward, link_frames

PANDA = configs.find("arms", "panda").with_suffix(".urdf")


def product(path: Path, joints: np.ndarray) -> list[np.ndarray]:
    """Base from each moving link, and last from the flange, one transform of the file after the other."""
    place, frames, angles = np.eye(4), [], iter(joints)
    for joint in ElementTree.parse(path).getroot().iter("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        xyz, rpy = (np.array(origin.get(name).split(), float) for name in ("xyz", "rpy"))
        place = place @ pose.rigid(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)
        if joint.get("type") != "fixed":
            place = place @ pose.from_rotation_vector(next(angles) * np.array(axis.get("xyz").split(), float))
            frames.append(place)
    return [*frames, place]


def test_the_pandas_chain_equals_the_product_of_its_file() -> None:
    chain, rng = read_chain(PANDA, "panda_link0", "panda_link8"), np.random.default_rng(0)
    for joints in rng.uniform(-3, 3, (20, 7)):
        expected = product(PANDA, joints)
        np.testing.assert_allclose(forward(joints, chain.links), expected[-1], atol=1e-12)
        own = link_frames(joints, chain.links) @ chain.own_frames
        np.testing.assert_allclose(own[0], np.eye(4), atol=1e-12)
        np.testing.assert_allclose(own[1:], expected[:-1], atol=1e-12)


def test_it_equals_another_reader() -> None:
    urchin = pytest.importorskip("urchin", reason="urchin, which comes with EAIK, has no wheel for this Python")
    robot, arm = urchin.URDF.load(str(PANDA), lazy_load_meshes=True), load_arm("panda")
    names = [f"panda_joint{number}" for number in range(1, 8)]
    assert robot.actuated_joint_names == names
    for joints in np.random.default_rng(1).uniform(arm.lower, arm.upper, (20, 7)):
        links = robot.link_fk(dict(zip(names, joints, strict=True)), use_names=True)
        expected = np.linalg.inv(links["panda_link0"]) @ links["panda_link8"]
        np.testing.assert_allclose(arm.forward(joints), expected, atol=1e-9)


def test_the_pandas_flange_is_where_its_maker_says() -> None:
    """All joints at zero: 88 mm before the base and 0.333 + 0.316 + 0.384 - 0.107 m high, looking down."""
    flange = load_arm("panda").forward(np.zeros(7))
    np.testing.assert_allclose(flange[:3, 3], [0.088, 0.0, 0.926], atol=1e-12)
    np.testing.assert_allclose(flange[:3, :3], np.diag([1, -1, -1]), atol=1e-12)


unit = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)
axis = st.one_of(unit, st.sampled_from([(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)]))
point = st.tuples(*[st.sampled_from([-0.5, -0.1, 0.0, 0.2, 0.4])] * 3)


@given(st.lists(st.tuples(point, axis), min_size=1, max_size=7), st.integers(0, 2**31))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_axes_turn_as_they_should(lines: list, seed: int) -> None:
    """Parallel, crossing, and equal axes included: rotations about fixed lines, one after the other, move the flange."""
    points = np.array([line[0] for line in lines], float)
    axes = np.array([line[1] for line in lines], float)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rng = np.random.default_rng(seed)
    flange = pose.from_rotation_vector(rng.normal(size=3), rng.normal(size=3))
    joints = rng.uniform(-3, 3, len(lines))
    moved = np.eye(4)
    for angle, place, direction in zip(joints, points, axes, strict=True):
        about = pose.rigid(np.eye(3), place)
        moved = moved @ about @ pose.from_rotation_vector(angle * direction) @ pose.inverse(about)
    links = from_axes(points, axes, flange)
    np.testing.assert_allclose(forward(joints, links), moved @ flange, atol=1e-6)  # axes that are parallel to 1e-9 and far apart


def changed(tmp_path: Path, old: str, new: str) -> Path:
    text = PANDA.read_text()
    assert old in text
    (tmp_path / "arm.urdf").write_text(text.replace(old, new, 1))
    return tmp_path / "arm.urdf"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<robot", "<robot <", "is not valid XML"),
        ("<robot", "<!DOCTYPE robot><robot", "it declares entities"),
        ('type="revolute"', 'type="prismatic"', "'panda_joint1' is prismatic"),
        ('<parent link="panda_link3"/>', '<parent link="elsewhere"/>', "no joint leads from 'panda_link0' to 'elsewhere'"),
        ('xyz="0 0 0.333"', 'xyz="0 0 nan"', "'panda_joint1' needs 3 finite numbers"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "'panda_joint1' has no axis"),
        ('<parent link="panda_link0"/>', "", "'panda_joint1' has no parent"),
    ],
)
def test_a_wrong_file_is_one_clear_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises((DatasetError, UsageError), match=words):
        read_chain(changed(tmp_path, old, new), "panda_link0", "panda_link8")


def test_a_joint_without_limits_needs_them_in_the_arm_file(tmp_path: Path) -> None:
    changed(tmp_path, 'type="revolute"', 'type="continuous"')
    text = configs.find("arms", "panda").read_text().replace("panda.urdf", "arm.urdf")
    (tmp_path / "arm.yaml").write_text(text)
    with pytest.raises(UsageError, match=r"limits\.lower_deg is missing"):
        load_arm(tmp_path / "arm.yaml")
