"""Files about where the camera is: easy_handeye2, URDF, xacro, and ROS 2's launch files."""

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.export.cameras import commented
from koala3d.calib.export.source import BODY, BODY_FROM_OPTICAL, FRAMES, Source, text
from koala3d.datasets import pose

OPTICAL = FRAMES["camera"]


def easy_handeye2(source: Source) -> str:
    """What the publisher of easy_handeye2 reads from NAME.calib: the carrier's frame from the camera's."""
    _, matrix = source.pose()
    xyz, (w, x, y, z) = matrix[:3, 3].tolist(), pose.quaternion(matrix).tolist()
    parameters = {
        "name": source.name,
        "calibration_type": "eye_in_hand" if source.on_flange else "eye_on_base",
        "robot_base_frame": FRAMES["base"],
        "robot_effector_frame": FRAMES["flange"],
        "tracking_base_frame": OPTICAL,
        "tracking_marker_frame": FRAMES["board"],
        "freehand_robot_movement": False,
    }
    transform = {"translation": dict(zip("xyz", xyz, strict=True)), "rotation": {"x": x, "y": y, "z": z, "w": w}}
    return commented([*source.notes(), *source.frame_notes()], {"parameters": parameters, "transform": transform})


def urdf(source: Source) -> str:
    """A robot of three links: the carrier, the camera's body frame on it, and its optical frame."""
    parent, _ = source.pose()
    return (
        '<?xml version="1.0"?>\n'
        f'{_comment(source)}<robot name="camera">\n  <link name="{parent}"/>\n{_camera(source, parent)}</robot>\n'
    )


def xacro(source: Source) -> str:
    """A macro that puts the camera on a link of one's own robot."""
    parent, _ = source.pose()
    usage = f'Include this file and call <xacro:koala_camera/> in a robot that has the link {parent}, or give parent="...".'
    return (
        '<?xml version="1.0"?>\n'
        f'{_comment(source, usage)}<robot xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        f'<xacro:macro name="koala_camera" params="parent:={parent}">\n{_camera(source, "${parent}")}</xacro:macro>\n</robot>\n'
    )


def launch(source: Source) -> str:
    """A ROS 2 launch file that publishes camera and board on tf, as MoveIt's hand-eye calibration exports it."""
    nodes = []
    for name in ("camera", "board"):
        if name == "camera" or any(one.endswith("_from_board") for one in source.calibration.poses):
            nodes.append(_publisher(*source.pose(name), FRAMES[name]))
    usage = "Start it with: ros2 launch FILE. Parent and child are frame-id and child-frame-id."
    return f'<?xml version="1.0"?>\n{_comment(source, usage)}<launch>\n{"".join(nodes)}</launch>\n'


def roll_pitch_yaw(matrix: Array) -> str:
    """`xyz` and `rpy` of a (4, 4) place as a URDF has them: turns about the fixed x, then y, then z."""
    return f'xyz="{text(*matrix[:3, 3])}" rpy="{text(*pose.roll_pitch_yaw(matrix))}"'


def _publisher(parent: str, matrix: Array, child: str) -> str:
    """A node of a launch file that publishes one transform."""
    w, x, y, z = pose.quaternion(matrix)
    numbers = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*matrix[:3, 3], x, y, z, w), strict=True))
    words = " ".join(f"--{name} {text(value)}" for name, value in numbers.items())
    arguments = f"{words} --frame-id {parent} --child-frame-id {child}"
    name = f"koala_{child}"
    return f'  <node pkg="tf2_ros" exec="static_transform_publisher" name="{name}"\n        args="{arguments}"/>\n'


def _camera(source: Source, parent: str) -> str:
    """Links and joints of the camera. REP 103: the body frame is mounted, the optical frame hangs on it."""
    _, matrix = source.pose()
    body = matrix @ pose.inverse(BODY_FROM_OPTICAL)
    joints = ((parent, BODY, body), (BODY, OPTICAL, BODY_FROM_OPTICAL))
    return "".join(
        f'  <link name="{child}"/>\n'
        f'  <joint name="{child}_joint" type="fixed">\n'
        f'    <origin {roll_pitch_yaw(np.asarray(place))}/>\n    <parent link="{above}"/>\n    <child link="{child}"/>\n'
        "  </joint>\n"
        for above, child, place in joints
    )


def _comment(source: Source, *more: str) -> str:
    """Notes as a comment of XML, which may not hold two hyphens."""
    notes = [*source.notes(), *source.frame_notes(), *more]
    lines = "\n".join(f"     {note}" for note in notes).strip().replace("--", "- -")
    return f"<!-- {lines} -->\n"
