"""A rig and a plan for other programs, such as MoveIt: the rig as a URDF, and the plan as joint angles with times.

folder/rig.urdf      arm, camera, mount, what stands around the arm, table and ceiling
folder/plan.json     names of the joints, and their angles at each time
folder/meshes/       obstacles that the rig file gives as meshes, in metres

A URDF has no capsules: each becomes a cylinder between two spheres. The file's own frame of a link is that of its joint, with z
along the axis; the link `base` is the one in which a controller of Universal Robots gives poses (ROS calls it `base` too).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.arm import ArmModel
from koala3d.capture.model.parts import Part
from koala3d.capture.model.shapes.solids import BoxSolid, CylinderSolid, Solid
from koala3d.capture.model.trajectory import Trajectory
from koala3d.capture.planning.durations import arrivals
from koala3d.capture.planning.obstacles import Obstacles
from koala3d.capture.planning.plan import PlannedView
from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.kinematics import link_frames

Array = NDArray[np.float64]
UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""As Universal Robots' ROS packages call them, each with "_joint" behind it."""
PLANE_M, THICK_M = 4.0, 0.02  # extent of table and ceiling, which have no end in a plan


def write(folder: Path, trajectory: Trajectory, obstacles: Obstacles, planned: list[PlannedView]) -> None:
    """Write both files. Raises UsageError: the folder exists and is not empty."""
    with files.atomic_folder(folder) as temporary:
        root = rig(obstacles, temporary)
        ElementTree.indent(root)
        files.write_text(temporary / "rig.urdf", ElementTree.tostring(root, encoding="unicode") + "\n")
        files.write_json(temporary / "plan.json", motion(trajectory, obstacles, planned))


def joint_names(arm: ArmModel) -> list[str]:
    """Of an arm's joints, from the base to the flange."""
    if arm.family == "ur":
        return [f"{name}_joint" for name in UR_JOINTS]
    return [f"joint_{number}" for number in range(1, arm.count + 1)]


def motion(trajectory: Trajectory, obstacles: Obstacles, planned: list[PlannedView]) -> dict[str, Any]:
    """A plan as a ROS message of type JointTrajectory has it, with the view that is taken at a point, if any.

    The arm rests at every point: each is there twice, when the arm arrives and when it leaves. Times and angles are those of
    the plan, which assumes that all joints start and stop together.
    """
    carrier, points = obstacles.carrier, list[dict[str, Any]]()
    for view, times in zip(planned, arrivals(trajectory, planned, carrier), strict=True):
        for number, corner in enumerate(view.path):
            taken = view.viewpoint.name if number + 1 == len(view.path) else None
            for time in times[2 * number : 2 * number + 2]:
                points.append({"view": taken, "time_from_start": time, "positions": corner.tolist()})
    limits = {"max_velocity": carrier.arm.speed, "max_acceleration": carrier.arm.acceleration}
    return {
        "trajectory": trajectory.name,
        "arm": carrier.arm.name,
        "joint_names": joint_names(carrier.arm),
        "limits": limits,
        "points": points,
    }


def rig(obstacles: Obstacles, folder: Path) -> Element:
    """The URDF of a rig; meshes are written below `folder`."""
    carrier, arm = obstacles.carrier, obstacles.carrier.arm
    root = Element("robot", name=arm.name.replace(" ", "_"))
    frames = _own_frames(arm)
    shapes: dict[int, list[Part]] = {}
    for part in carrier.shape.parts:
        shapes.setdefault(part.link, []).append(part)
    names = ["base", *(name.removesuffix("_joint") + "_link" for name in joint_names(arm)), "flange"]
    for number, name in enumerate(names):
        link = SubElement(root, "link", name=name)
        # the last moving link carries nothing itself: what is on it is given in the frame of the flange
        for part in shapes.get(arm.count, []) if name == "flange" else shapes.get(number, []) if number < arm.count else []:
            _capsule(link, part, np.eye(4) if name == "flange" else frames[number][1])
    for number, name in enumerate(joint_names(arm)):
        joint = _joint(root, name, "revolute", names[number], names[number + 1], frames[number][1] @ frames[number + 1][0])
        SubElement(joint, "axis", xyz="0 0 1")
        lower, upper, speed = (_text(one[number]) for one in (arm.lower, arm.upper, arm.speed))
        SubElement(joint, "limit", lower=lower, upper=upper, velocity=speed, effort="0")
    _joint(root, "flange_joint", "fixed", names[-2], "flange", frames[-1][1])
    SubElement(root, "link", name="camera")
    stands = carrier.beside is not None
    place = carrier.beside.base_from_camera if carrier.beside is not None else carrier.flange_from_camera
    _joint(root, "camera_joint", "fixed", "base" if stands else "flange", "camera", place)
    for name, solid in _named(obstacles, set(names) | {"camera"}):
        _standing(root, name, solid, folder)
    return root


def _own_frames(arm: ArmModel) -> list[tuple[Array, Array]]:
    """For the base and each joint: (4, 4) from the chain's frame before it to the file's own, and from that one on to the next.

    A link is rot_z(theta) trans_z(d) trans_x(a) rot_x(alpha): the file's frame is behind rot_z, and the rest follows it.
    """
    links = arm.links
    zero = link_frames(np.zeros(arm.count), links)
    frames = [(np.eye(4), np.asarray(links.base, np.float64))]
    for number, theta in enumerate(links.theta):
        turn = pose.from_rotation_vector([0.0, 0.0, theta])
        before = zero[number] if number else np.asarray(links.base, np.float64)
        frames.append((turn, pose.inverse(before @ turn) @ zero[number + 1]))
    return frames


def _named(obstacles: Obstacles, taken: set[str]) -> Iterator[tuple[str, Solid]]:
    """What stands around the arm, with names that a URDF may have, each once."""
    solids = list(obstacles.carrier.solids)
    for name, height, away in (("table", obstacles.table_z, obstacles.up), ("ceiling", obstacles.ceiling_z, -obstacles.up)):
        if height is not None:
            place = {"position": [0.0, 0.0, height - away * THICK_M / 2]}
            solids.append(
                BoxSolid.model_validate({"kind": "box", "name": name, "size": (PLANE_M, PLANE_M, THICK_M), "pose": place})
            )
    for solid in solids:
        name = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in solid.name)
        while name in taken:
            name += "_"
        taken.add(name)
        yield name, solid


def _standing(root: Element, name: str, solid: Solid, folder: Path) -> None:
    link = SubElement(root, "link", name=name)
    place = solid.pose.matrix()
    if isinstance(solid, BoxSolid):
        _shape(link, "box", np.eye(4), size=_text(*solid.size))
    elif isinstance(solid, CylinderSolid):
        _shape(link, "cylinder", np.eye(4), radius=_text(solid.radius), length=_text(solid.height))
    else:
        import trimesh

        (folder / "meshes").mkdir(exist_ok=True)
        trimesh.Trimesh(*solid.outline(), process=False).export(folder / "meshes" / f"{name}.stl")
        _shape(link, "mesh", np.eye(4), filename=f"meshes/{name}.stl")
        place = np.eye(4)  # the outline is in the base
    _joint(root, f"{name}_joint", "fixed", "base", name, place)


def _capsule(link: Element, part: Part, own: Array) -> None:
    """A capsule between two points, which `own` takes to the frame of the link."""
    start, end = (own[:3, :3] @ one + own[:3, 3] for one in (part.start, part.end))
    length = float(np.linalg.norm(end - start))
    for point in (start, end):
        _shape(link, "sphere", pose.rigid(np.eye(3), point), name=part.name, radius=_text(part.radius))
    if length > 0:
        along = (end - start) / length
        across = np.linalg.svd(along[None])[2][1]
        rotation = np.column_stack([across, np.cross(along, across), along])
        place = pose.rigid(rotation, (start + end) / 2)
        _shape(link, "cylinder", place, name=part.name, radius=_text(part.radius), length=_text(length))


def _shape(link: Element, kind: str, place: Array, *, name: str = "", **numbers: str) -> None:
    """A body to be seen and to collide with."""
    for purpose in ("visual", "collision"):
        element = SubElement(link, purpose, {"name": name.replace(" ", "_")} if name else {})
        _origin(element, place)
        SubElement(SubElement(element, "geometry"), kind, numbers)


def _joint(root: Element, name: str, kind: str, parent: str, child: str, place: Array) -> Element:
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    _origin(joint, place)
    return joint


def _origin(element: Element, place: Array) -> None:
    """A (4, 4) place as `xyz` and `rpy`, the turns about the fixed x, then y, then z."""
    SubElement(element, "origin", xyz=_text(*place[:3, 3]), rpy=_text(*pose.roll_pitch_yaw(place)))


def _text(*numbers: float) -> str:
    return " ".join(repr(float(one) + 0.0) for one in numbers)
