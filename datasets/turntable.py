"""A turntable's axis, and where the cameras stood about an object that turned on it.

The object's frame is the robot's base as it was with the table at angle zero. A point x of the object is then at

    base_from_object(angle) @ x,   base_from_object(angle) = shift(point) @ rotation(angle * direction) @ shift(-point)

in the base, so that world_from_camera = inverse(base_from_object(angle)) @ base_from_camera. At angle zero both frames are one.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError

Array = NDArray[np.float64]


def before_turntable(axis: ArrayLike, scene_from_camera: ArrayLike) -> Array:
    """(..., 3, 3) rotations from the scene's axes to those of a room in which every camera is at the azimuth zero.

    The room's z is the (3,) axis, a unit vector in the scene. The azimuth of a camera that looks along it is that to which the
    bottom of its picture points. Where a turntable turned the object before a camera that stood on one side of the room, that is
    how the object was turned, but for a rotation that all views share.
    """
    rotation = np.asarray(scene_from_camera, np.float64)
    axis = np.broadcast_to(np.asarray(axis, np.float64), rotation.shape[:-1])
    back = -rotation[..., 2] + 1e-5 * rotation[..., 1]  # y is down
    back = back - np.sum(back * axis, -1, keepdims=True) * axis
    back = back / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-30)
    return np.stack([back, np.cross(axis, back), axis], -2)


@dataclass(frozen=True)
class Axis:
    """The axis about which a table turns, in the base frame, with the covariance of its error."""

    point: Array
    """(3,) a point on the axis [m]."""
    direction: Array
    """(3,) unit vector; positive angles turn about it by the right-hand rule."""
    covariance: Array
    """(6, 6): point [m^2] first, then direction [1]. Of rank 4: neither a shift along the axis nor a longer vector is another."""

    @classmethod
    def of(cls, base_from_turntable: ArrayLike) -> Self:
        """The z axis of a (4, 4) pose [m] that is known exactly."""
        matrix = np.asarray(base_from_turntable, np.float64)
        return cls(matrix[:3, 3].copy(), matrix[:3, 2].copy(), np.zeros((6, 6)))

    def base_from_object(self, angle: ArrayLike) -> Array:
        """(..., 4, 4) pose [m] of the object's frame with the table at (...) angles [rad]."""
        angles = np.asarray(angle, np.float64)
        vectors = angles.reshape(-1, 1) * self.direction
        turns = Rotation.from_rotvec(vectors).as_matrix().reshape(*angles.shape, 3, 3)
        return pose.rigid(turns, self.point - turns @ self.point)

    @property
    def tilt_std_deg(self) -> float:
        """Standard deviation of the direction, over both ways to tilt it [deg]."""
        return float(np.rad2deg(np.sqrt(np.trace(self.covariance[3:, 3:]))))

    @property
    def shift_std_mm(self) -> float:
        """Standard deviation of the point, over both ways to shift the axis [mm]."""
        return float(1e3 * np.sqrt(np.trace(self.covariance[:3, :3])))

    def difference(self, other: "Axis") -> tuple[float, float]:
        """Distance of this axis from the point of another [m], and the angle between the two [rad]."""
        away = self.point - other.point
        shift = away - (away @ self.direction) * self.direction
        turn = np.arctan2(np.linalg.norm(np.cross(self.direction, other.direction)), self.direction @ other.direction)
        return float(np.linalg.norm(shift)), float(turn)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary."""
        names = {"point_m": self.point, "direction": self.direction, "covariance": self.covariance}
        return {name: value.tolist() for name, value in names.items()}

    @classmethod
    def from_json(cls, content: Any, *, where: object) -> Self:
        """Axis from `to_json`'s dictionary; raises DatasetError where it is incomplete or impossible."""
        try:
            point, direction = (np.asarray(content[key], np.float64).reshape(3) for key in ("point_m", "direction"))
            covariance = np.asarray(content["covariance"], np.float64).reshape(6, 6)
        except (TypeError, KeyError, ValueError) as error:
            raise DatasetError("axis of the turntable is not complete", where=where, why=str(error)) from None
        length = float(np.linalg.norm(direction))
        good = np.isfinite([*point, *direction, *covariance.ravel()]).all() and (np.diag(covariance) >= 0).all()
        if not good or abs(length - 1) > 1e-3:
            why = f"point {point.tolist()}, direction {direction.tolist()}"
            raise DatasetError("axis of the turntable is impossible", where=where, why=why, remedy="calibrate it again")
        return cls(point, direction / length, covariance)
