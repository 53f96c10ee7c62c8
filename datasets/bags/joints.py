"""The joints of a URDF, the description of a robot in ROS: links are frames, and each joint puts one in another.

Numbers are read when they are asked for, so that a joint that nobody needs may be as it likes. Shapes are not read.
"""

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError

TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)
"""Kinds of joints that move."""


@dataclass(frozen=True)
class Joint:
    """A joint between two links."""

    element: ElementTree.Element
    where: Any
    """What errors name: the file."""

    @property
    def name(self) -> str:
        """Empty if it has none."""
        return self.element.get("name", "")

    @property
    def kind(self) -> str:
        """`revolute`, `continuous`, `prismatic`, `fixed`, ..."""
        return self.element.get("type", "fixed")

    @property
    def parent(self) -> str:
        """Name of the link that it stands on."""
        return self._link("parent")

    @property
    def child(self) -> str:
        """Name of the link that it moves."""
        return self._link("child")

    @property
    def origin(self) -> Float[np.ndarray, "4 4"]:
        """parent_from_joint [m]; `rpy` turns about the fixed x, then y, then z."""
        from scipy.spatial.transform import Rotation

        element = self.element.find("origin")
        xyz, rpy = ("0 0 0", "0 0 0") if element is None else (element.get("xyz", "0 0 0"), element.get("rpy", "0 0 0"))
        return pose.rigid(Rotation.from_euler("xyz", self._numbers(rpy, 3)).as_matrix(), self._numbers(xyz, 3))

    @property
    def axis(self) -> Float[np.ndarray, " 3"]:
        """Unit vector in the joint's frame, about which or along which it moves."""
        element = self.element.find("axis")
        axis = self._numbers("1 0 0" if element is None else element.get("xyz", "1 0 0"), 3)
        if np.linalg.norm(axis) < 1e-6:
            raise DatasetError(f"joint '{self.name}' has no axis", where=self.where)
        return np.asarray(axis / np.linalg.norm(axis))

    @property
    def limits(self) -> tuple[float, float, float]:
        """Lowest and highest position [rad or m], and largest speed [rad/s or m/s]; infinite where there is none."""
        element = self.element.find("limit")
        limit = {} if element is None else dict(element.items())
        speed = float(self._numbers(limit["velocity"], 1)[0]) if "velocity" in limit else np.inf
        if self.kind == "continuous":
            return -np.inf, np.inf, speed
        low, high = (float(self._numbers(limit.get(name, "0"), 1)[0]) for name in ("lower", "upper"))
        return low, high, speed

    def _link(self, which: str) -> str:
        element = self.element.find(which)
        found = None if element is None else element.get("link")
        if not found:
            raise DatasetError(f"joint '{self.name}' has no {which}", where=self.where)
        return found

    def _numbers(self, text: str, count: int) -> Float[np.ndarray, " count"]:
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            numbers = np.zeros(0)
        if numbers.shape != (count,) or not np.isfinite(numbers).all():
            why, remedy = f"got '{text[:60]}'", "expand it with xacro"
            raise DatasetError(f"joint '{self.name}' needs {count} finite numbers", where=self.where, why=why, remedy=remedy)
        return numbers


def joints_by_child(text: str, *, where: object) -> dict[str, Joint]:
    """The joints of a URDF by the link that each moves.

    Properties of a joint raise DatasetError if the file does not say what they need, in a form that can be read.

    Raises DatasetError: it is no URDF, it declares entities, or a joint names no child.
    """
    root = files.parse_xml(text, where=where)
    if root.tag != "robot":
        raise DatasetError("is not a URDF file", where=where, why=f"its root is <{root.tag[:60]}>, not <robot>")
    joints = [Joint(element, where) for element in root.findall("joint")]
    return {joint.child: joint for joint in joints}
