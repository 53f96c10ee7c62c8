"""An arm as it was built: the calibrated links that its controller reports, in place of the nominal ones of its model."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.model.arm import BUILT_M, ArmModel
from koala3d.capture.model.inverse.numerical import improved
from koala3d.datasets import kinematics, pose
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.kinematics import Links

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BuiltArm:
    """A model of arm, with the links of one that was built.

    The frame of a calibrated link may lie far from that of the nominal one: if two axes are parallel but for some milliradians,
    their common normal, on which the Denavit-Hartenberg convention puts the frame, is hundreds of metres away. `frames` has the
    z axis of each of these frames, and its origin and x axis as near to the nominal ones as the axis allows, at zero angles.

    Raises UsageError: the links are those of another model.
    """

    model: ArmModel
    links: Links

    def __post_init__(self) -> None:
        if self.links.count != self.model.count or (off := self._off()) > BUILT_M:
            found = f"{self.links.count} joints" if self.links.count != self.model.count else f"its flange is {off:.3f} m away"
            why = f"{found}, real arms differ from their model by at most {BUILT_M:g} m"
            raise UsageError(f"these links are not those of a {self.model.name}", why=why, remedy="correct robot.model")

    def _off(self) -> float:
        """Largest distance of the flange from the nominal one [m], at angles all around."""
        joints = np.random.default_rng(0).uniform(-np.pi, np.pi, (64, self.model.count))
        return float(pose.difference(kinematics.forward(joints, self.links), self.model.forward(joints))[0].max())

    def forward(self, joints: ArrayLike) -> Array:
        """(..., 4, 4) `base_from_flange` [m] of (..., n) joint angles [rad]."""
        return kinematics.forward(joints, self.links)

    def frames(self, joints: ArrayLike) -> Array:
        """(..., n + 1, 4, 4) poses of base and links [m], to which the parts of the arm's shape are fixed."""
        return np.asarray(kinematics.link_frames(joints, self.links) @ self._shifts)

    @cached_property
    def _shifts(self) -> Array:
        """(n + 1, 4, 4) from the frame of each calibrated link to the one of `frames`."""
        nominal, built = (kinematics.link_frames(np.zeros(self.model.count), one) for one in (self.model.links, self.links))
        shifts = np.tile(np.eye(4), (len(built), 1, 1))
        for index in range(1, len(built) - 1):
            z, origin = built[index, :3, 2], built[index, :3, 3]
            near = nominal[index, :3, 3]
            x = nominal[index, :3, 0] - z * (z @ nominal[index, :3, 0])
            x /= np.linalg.norm(x)
            wanted = pose.rigid(np.stack([x, np.cross(z, x), z], axis=-1), origin + z * (z @ (near - origin)))
            shifts[index] = pose.inverse(built[index]) @ wanted
        return shifts

    def near(self, base_from_flange: ArrayLike, joints: ArrayLike) -> Array:
        """(m, n) joint angles [rad] next to (n,) nominal ones that bring the flange to the (4, 4) pose; m is 1, or 0: none."""
        return improved(np.asarray(base_from_flange, np.float64), np.asarray(joints, np.float64)[None], self.links)

    def inverse(self, base_from_flange: ArrayLike) -> Array:
        """(m, n) joint angles [rad, -pi..pi] of the branches that reach the (4, 4) pose: the nominal ones, brought onto it."""
        target = np.asarray(base_from_flange, np.float64)
        found = improved(target, self.model.inverse(target), self.links)
        return np.arctan2(np.sin(found), np.cos(found))
