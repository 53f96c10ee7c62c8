"""URDF, the Unified Robot Description Format of ROS (wiki.ros.org/urdf/XML/link): one link without joints."""

from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from koala3d.reconstruct.asset.robot.body import Body

FILE = "object.urdf"
ENTRIES = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def text(body: Body, name: str, visual: str, parts: Sequence[str]) -> str:
    """The file's text.

    Args:
        body: what to describe.
        name: of the robot and its link.
        visual: file of the textured mesh, relative to the URDF file.
        parts: files of the convex parts.
    """
    robot = Element("robot", name=name)
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(body.inertia.centre), rpy="0 0 0")
    SubElement(inertial, "mass", value=numbers([body.inertia.mass]))
    SubElement(inertial, "inertia", {key: numbers([body.inertia.tensor[at]]) for key, at in ENTRIES.items()})
    for kind, files in (("visual", [visual]), ("collision", parts)):
        for file in files:
            SubElement(SubElement(SubElement(link, kind), "geometry"), "mesh", filename=file)
    return document(robot)


def numbers(values: Sequence[float] | np.ndarray) -> str:
    """Numbers as an attribute."""
    return " ".join(f"{value:.9g}" for value in values)


def document(root: Element) -> str:
    """An indented XML document."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
