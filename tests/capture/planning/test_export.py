"""The URDF of a rig is read back, by the project's reader and by the product of its transforms; the plan is the plan."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from koala3d.capture.cli.plan import plan as plan_command
from koala3d.capture.model.arm import load_arm
from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.shapes.solids import BoxSolid, CylinderSolid, MeshSolid
from koala3d.capture.model.urdf import read_chain
from koala3d.capture.planning import Obstacles, export
from koala3d.datasets import pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import forward

MOUNT = pose.from_rotation_vector([0.7, 0.1, -0.3], [0.01, 0.06, 0.08])


def written(folder: Path, arm: str, **others: object) -> tuple[Obstacles, ElementTree.Element]:
    obstacles = Obstacles(Carrier(load_arm(arm), MOUNT, **others), 0.02, table_z=-0.1, ceiling_z=2.0)  # type: ignore[arg-type]
    root = export.rig(obstacles, folder)
    (folder / "rig.urdf").write_text(ElementTree.tostring(root, encoding="unicode"))
    return obstacles, root


def origin(element: ElementTree.Element) -> np.ndarray:
    xyz, rpy = (np.array(element.find("origin").get(name).split(), float) for name in ("xyz", "rpy"))
    return pose.rigid(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def places(root: ElementTree.Element, joints: np.ndarray) -> dict[str, np.ndarray]:
    """(4, 4) base_from_link of every link, by the product of the file's transforms."""
    found, angles, left = {"base": np.eye(4)}, iter(joints), list(root.iter("joint"))
    for joint in left:
        place = found[joint.find("parent").get("link")] @ origin(joint)
        if joint.get("type") == "revolute":
            place = place @ pose.from_rotation_vector(next(angles) * np.array(joint.find("axis").get("xyz").split(), float))
        found[joint.find("child").get("link")] = place
    return found


@pytest.mark.parametrize("name", ["ur5e", "ur7e", "ur15", "ur20", "ur30", "panda"])
def test_the_chain_is_read_back(tmp_path: Path, name: str) -> None:
    obstacles, root = written(tmp_path, name)
    arm, rng = obstacles.carrier.arm, np.random.default_rng(0)
    chain = read_chain(tmp_path / "rig.urdf", "base", "flange")
    for joints in rng.uniform(arm.lower, arm.upper, (20, arm.count)):
        np.testing.assert_allclose(forward(joints, chain.links), arm.forward(joints), atol=1e-9)
        found = places(root, joints)
        np.testing.assert_allclose(found["flange"], arm.forward(joints), atol=1e-9)
        np.testing.assert_allclose(found["camera"], obstacles.carrier.base_from_camera(joints), atol=1e-9)
    for own, wanted in ((chain.lower, arm.lower), (chain.upper, arm.upper), (chain.speed, arm.speed)):
        np.testing.assert_allclose(own, wanted, atol=1e-12)
    assert [joint.get("name") for joint in root.iter("joint") if joint.get("type") == "revolute"] == export.joint_names(arm)


@pytest.mark.parametrize("name", ["ur10e", "panda"])
def test_the_bodies_are_where_the_planner_has_them(tmp_path: Path, name: str) -> None:
    obstacles, root = written(tmp_path, name)
    carrier, rng = obstacles.carrier, np.random.default_rng(1)
    joints = rng.uniform(carrier.arm.lower, carrier.arm.upper)
    found, met = places(root, joints), dict[str, list[np.ndarray]]()
    for link in root.iter("link"):
        for body in link.iter("collision"):
            centre = found[link.get("name")] @ origin(body)
            if body.find("geometry/sphere") is not None:
                met.setdefault(body.get("name"), []).append(centre[:3, 3])
            elif body.find("geometry/cylinder") is not None:
                ends = met[body.get("name")]
                half = float(body.find("geometry/cylinder").get("length")) / 2
                np.testing.assert_allclose(centre[:3, 3] + half * centre[:3, 2], ends[1], atol=1e-9)
                np.testing.assert_allclose(centre[:3, 3] - half * centre[:3, 2], ends[0], atol=1e-9)
    segments = carrier.segments(joints)
    assert len(met) == len(carrier.shape.parts)
    for part, ends in zip(carrier.shape.parts, segments, strict=True):
        np.testing.assert_allclose(met[part.name.replace(" ", "_")], ends, atol=1e-9)


def test_what_stands_around_the_arm_is_fixed_to_the_base(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.1, 0.3)).export(tmp_path / "lamp.stl")
    solids = (
        BoxSolid.model_validate({"kind": "box", "name": "a wall", "size": (0.1, 2.0, 1.0), "pose": {"position": [1.0, 0, 0.5]}}),
        CylinderSolid.model_validate(
            {"kind": "cylinder", "name": "camera", "radius": 0.05, "height": 1.5, "pose": {"position": [0, 1.0, 0.7]}}
        ),
        MeshSolid.model_validate(
            {"kind": "mesh", "name": "lamp", "file": str(tmp_path / "lamp.stl"), "pose": {"position": [-0.4, 0.5, 0.3]}}
        ),
    )
    _, root = written(tmp_path, "ur5e", solids=solids)
    found = places(root, np.zeros(6))
    links = {link.get("name"): link for link in root.iter("link")}
    assert (
        len(links) == len(list(root.iter("link"))) and {"a_wall", "camera", "camera_", "lamp", "table", "ceiling"} <= links.keys()
    )
    np.testing.assert_allclose(found["a_wall"][:3, 3], [1.0, 0.0, 0.5])
    assert links["a_wall"].find("collision/geometry/box").get("size") == "0.1 2.0 1.0"
    assert links["camera_"].find("collision/geometry/cylinder").attrib == {"radius": "0.05", "length": "1.5"}
    tops = {name: found[name][2, 3] + sign * 0.01 for name, sign in (("table", 1), ("ceiling", -1))}
    assert tops == pytest.approx({"table": -0.1, "ceiling": 2.0})
    file = links["lamp"].find("collision/geometry/mesh").get("filename")
    assert file == "meshes/lamp.stl"
    corners = trimesh.load(tmp_path / file).vertices @ found["lamp"][:3, :3].T + found["lamp"][:3, 3]
    np.testing.assert_allclose(np.stack([corners.min(0), corners.max(0)]), [[-0.5, 0.45, 0.15], [-0.3, 0.55, 0.45]], atol=1e-6)


@pytest.mark.parametrize("angle", [0.3, np.pi / 2, -np.pi / 2])
def test_turns_are_written_upright_too(angle: float) -> None:
    """A pitch of a quarter turn leaves only the sum of roll and yaw."""
    for first in (0.0, 0.4):
        place = pose.rigid(Rotation.from_euler("ZYX", [first, angle, 0.7]).as_matrix(), [1, 2, 3])
        element = ElementTree.Element("joint")
        export._origin(element, place)
        np.testing.assert_allclose(origin(element), place, atol=1e-7)  # the square root of the rounding, at a quarter turn


def test_the_command_writes_both_files_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan_command(Path("koala_demo"), urdf=tmp_path / "moveit")
    assert str(tmp_path / "moveit") in capsys.readouterr().out
    content = json.loads((tmp_path / "moveit" / "plan.json").read_text())
    times = np.array([point["time_from_start"] for point in content["points"]])
    assert (np.diff(times) > 0).all() and times[0] == 0 and content["joint_names"][2] == "elbow_joint"
    chain = read_chain(tmp_path / "moveit" / "rig.urdf", "base", "flange")
    arm, names = load_arm("ur5e"), [point["view"] for point in content["points"] if point["view"] is not None]
    assert len(set(names)) * 2 == len(names) > 8  # each view is there when the arm arrives and when it leaves
    for point in content["points"]:
        assert arm.inside(point["positions"])
        np.testing.assert_allclose(forward(point["positions"], chain.links), arm.forward(point["positions"]), atol=1e-9)
    moves = np.abs(np.diff([point["positions"] for point in content["points"]], axis=0)) / np.diff(times)[:, None]
    assert moves.max() <= np.array(content["limits"]["max_velocity"]).max()
    with pytest.raises(UsageError, match="already exists"):
        plan_command(Path("koala_demo"), urdf=tmp_path / "moveit")
