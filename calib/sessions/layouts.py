"""From the numbers of a pose, as a file has them, to base_from_flange in metres."""

from collections.abc import Sequence
from contextlib import suppress
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.sessions.description import SEQUENCES, Description
from koala3d.calib.sessions.session import Reading
from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError, KoalaError

FURTHEST_M = 20.0  # from its base no arm gets
TURN = 2 * np.pi + 1e-6
UNITS = {"deg": "degrees", "rad": "radians"}


def as_pose(numbers: Sequence[float], description: Description, *, where: object) -> Array:
    """(4, 4) base_from_flange [m] out of the numbers of a file.

    Raises DatasetError for numbers that are no pose in this layout, CalibrationError for those that betray another unit or order.
    """
    values, layout, count = np.asarray(numbers, np.float64), description.layout, len(description.columns)
    if len(values) != count and not ("matrix" in layout and len(values) == 12):
        raise DatasetError(f"pose has {len(values)} numbers", where=where, why=f"layout {layout!r} has {count}")
    if not np.isfinite(values).all():
        raise DatasetError("pose is not finite", where=where, why="it holds NaN or infinity", remedy="remove the view")
    if "matrix" in layout:
        matrix = _from_matrix(values, layout, where)
    else:
        matrix = (_from_angles if description.has_angles else _from_quaternion)(values, description, where)
    matrix[:3, 3] *= 1e-3 if description.length == "mm" else 1.0
    if (furthest := np.abs(matrix[:3, 3]).max()) > FURTHEST_M:
        why, remedy = f"{furthest:.4g} m from its base", "millimetres? then say length: mm"
        raise CalibrationError("arm's position is not credible", where=where, why=why, remedy=remedy)
    return pose.inverse(matrix) if description.inverse else matrix


def other_readings(views: Sequence[Sequence[float]], description: Description) -> tuple[Reading, ...]:
    """Every other way to read three angles: as a rotation vector or Euler angles of any sequence, in degrees or radians."""
    found = []
    for euler, unit in product(SEQUENCES if description.has_angles else (), UNITS):
        other = description.model_copy(update={"layout": "x y z rx ry rz", "euler": euler, "angle": unit})
        kind = f"{f'Euler angles {euler}' if euler else 'rotation vectors'} in {UNITS[unit]}"
        said = f"euler: {euler} and angle: {unit}" if euler else f"layout: x y z rx ry rz and angle: {unit}, without euler"
        if (euler, unit) != (description.euler, description.angle):
            with suppress(KoalaError):  # numbers that cannot be read so
                poses = np.stack([as_pose(one, other, where=kind) for one in views])
                found.append(Reading(kind, said, poses))
    return tuple(found)


def _from_angles(values: Array, description: Description, where: object) -> Array:
    turn = np.deg2rad(values[3:]) if description.angle == "deg" else values[3:]
    kind, length = ("Euler angle", np.abs(turn).max()) if description.euler else ("rotation vector", np.linalg.norm(turn))
    if length > TURN:
        why = f"{length:.4g} rad"
        remedy = "Euler angles? then say which, see euler" if description.angle == "deg" else "degrees? then say angle: deg"
        raise CalibrationError(f"{kind} is longer than a full turn", where=where, why=why, remedy=remedy)
    if description.euler:
        return pose.rigid(Rotation.from_euler(description.euler, turn).as_matrix(), values[:3])
    return np.array(pose.from_rotation_vector(turn, values[:3]))


def _from_quaternion(values: Array, description: Description, where: object) -> Array:
    quaternion = values[3:] if description.layout.endswith("qz") else np.roll(values[3:], 1)
    if abs((length := np.linalg.norm(quaternion)) - 1) > 1e-2:
        why, remedy = f"its length is {length:.4g}", "check layout and file"
        raise CalibrationError("quaternion is not of unit length", where=where, why=why, remedy=remedy)
    return np.array(pose.from_quaternion(quaternion, values[:3]))


def _from_matrix(values: Array, layout: str, where: object) -> Array:
    rows = values.reshape(-1, 4) if layout == "matrix" else values.reshape(4, -1).T
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1], atol=1e-6):
        other = "matrix by columns" if layout == "matrix" else "matrix"
        hint = f"it is stored the other way: say layout: {other}" if np.allclose(rows[:, 3], [0, 0, 0, 1], atol=1e-6) else ""
        raise CalibrationError("last row of the pose is not 0 0 0 1", where=where, why=str(rows[3].tolist()), remedy=hint)
    return np.array(pose.checked(rows, where=where))
