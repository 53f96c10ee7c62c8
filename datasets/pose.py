"""Rigid transforms as 4x4 float64 matrices named `a_from_b`: they take coordinates in b to coordinates in a.

Neighbouring names cancel: `base_from_camera = base_from_flange @ flange_from_camera`. Lengths in metres, angles in
radians. Quaternions are `wxyz`; the robot speaks rotation vectors (axis times angle).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from koala3d.datasets.core.errors import DatasetError

Matrix = NDArray[np.float64]

SMALLEST = 1e-6
"""Scales below this are mistakes, and so are those above its inverse."""
VERTICAL = 1 - 1e-12
"""Sine of a pitch from which on roll and yaw turn about the same axis."""
FURTHEST = 1e12
"""Positions further away than this [world unit] are mistakes: their products would lose all digits."""


def rigid(rotation: ArrayLike, translation: ArrayLike) -> Matrix:
    """(..., 4, 4) transforms from (..., 3, 3) rotation matrices and (..., 3) translations [m]."""
    rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    pose = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    pose[..., :3, :3], pose[..., :3, 3], pose[..., 3, 3] = rotation, translation, 1.0
    return pose


def inverse(a_from_b: ArrayLike) -> Matrix:
    """`b_from_a`, exactly orthonormal where `a_from_b` is."""
    a_from_b = np.asarray(a_from_b, np.float64)
    b_from_a_rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    return rigid(b_from_a_rotation, -np.einsum("...ij,...j->...i", b_from_a_rotation, a_from_b[..., :3, 3]))


def from_rotation_vector(rotation_vector: ArrayLike, translation: ArrayLike = (0, 0, 0)) -> Matrix:
    """(4, 4) from a rotation vector [rad] and a translation [m]."""
    return rigid(Rotation.from_rotvec(np.asarray(rotation_vector, np.float64)).as_matrix(), translation)


def rotation_vector(pose: ArrayLike) -> NDArray[np.float64]:
    """(..., 3) axis times angle [rad, 0..pi] of (..., 4, 4) or (..., 3, 3)."""
    return Rotation.from_matrix(np.asarray(pose, np.float64)[..., :3, :3]).as_rotvec()


def from_quaternion(wxyz: ArrayLike, translation: ArrayLike = (0, 0, 0)) -> Matrix:
    """(4, 4) from a quaternion in `wxyz` order, normalised here, and a translation [m]."""
    return rigid(Rotation.from_quat(np.roll(np.asarray(wxyz, np.float64), -1, -1)).as_matrix(), translation)


def quaternion(pose: ArrayLike) -> NDArray[np.float64]:
    """(..., 4) unit quaternion `wxyz`, w >= 0."""
    xyzw = Rotation.from_matrix(np.asarray(pose, np.float64)[..., :3, :3]).as_quat(canonical=True)
    return np.roll(xyzw, 1, -1)


def roll_pitch_yaw(pose: ArrayLike) -> NDArray[np.float64]:
    """(3,) turns [rad] about the fixed x, then y, then z axis, as a URDF has them, of (4, 4) or (3, 3).

    Where the pitch is a quarter turn only the sum or difference of roll and yaw is defined: the roll is then 0.
    """
    rotation = np.asarray(pose, np.float64)[:3, :3]
    pitch = np.arcsin(np.clip(-rotation[2, 0], -1.0, 1.0))
    if abs(rotation[2, 0]) < VERTICAL:
        return np.array([np.arctan2(rotation[2, 1], rotation[2, 2]), pitch, np.arctan2(rotation[1, 0], rotation[0, 0])])
    return np.array([0.0, pitch, np.arctan2(-rotation[0, 1], rotation[1, 1])])


def rotation_angle(pose: ArrayLike) -> NDArray[np.float64]:
    """Rotation angle [rad, 0..pi]; accurate near 0 and near pi, unlike the arc cosine of the trace."""
    return np.linalg.norm(rotation_vector(pose), axis=-1)


def difference(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(translation distance [m], rotation angle [rad]) between two poses of the same frames."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return np.linalg.norm(a[..., :3, 3] - b[..., :3, 3], axis=-1), rotation_angle(inverse(a) @ b)


def rms_difference(a: ArrayLike, b: ArrayLike) -> tuple[float, float]:
    """Root mean square difference of two poses or (..., 4, 4) stacks of them: translation [mm], rotation [deg]."""
    distance, angle = difference(a, b)
    return 1e3 * float(np.sqrt(np.mean(distance**2))), float(np.rad2deg(np.sqrt(np.mean(angle**2))))


def cross(vectors: ArrayLike) -> NDArray[np.float64]:
    """(..., 3, 3) matrices of the cross product with (..., 3) vectors."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    none = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ((none, -z, y), (z, none, -x), (-y, x, none))], -2)


def rotations(count: int) -> NDArray[np.float64]:
    """(count, 3, 3) rotations, evenly spread: the super-Fibonacci spirals of Alexa (CVPR 2022)."""
    index = np.arange(count) + 0.5
    share, first, second = index / count, 2 * np.pi * index / np.sqrt(2), 2 * np.pi * index / 1.533751168755204288118041
    inner, outer = np.sqrt(share), np.sqrt(1 - share)
    quaternions = [inner * np.sin(first), inner * np.cos(first), outer * np.sin(second), outer * np.cos(second)]
    return np.asarray(Rotation.from_quat(np.stack(quaternions, -1)).as_matrix(), np.float64)


def directions(count: int) -> NDArray[np.float64]:
    """(count, 3) unit vectors that cover the sphere evenly (Fibonacci lattice)."""
    height = 1 - (2 * np.arange(count) + 1) / count
    angle, across = np.arange(count) * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - height**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), height], -1)


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Matrix:
    """`world_from_camera` (OpenCV axes) of a camera at `position` whose z axis meets `target`, y axis away from `up`."""
    position = np.asarray(position, np.float64)
    forward = np.asarray(target, np.float64) - position
    if np.linalg.norm(forward) < 1e-12:
        raise ValueError("position and target coincide")
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    if np.linalg.norm(right) < 1e-9:  # looking along `up`: any roll will do
        right = np.cross(forward, (0.0, 1.0, 0.0) if abs(forward[1]) < 0.9 else (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    return rigid(np.stack([right, np.cross(forward, right), forward], axis=-1), position)


def unscaled(pose: ArrayLike) -> tuple[ArrayLike, float]:
    """A matrix whose columns are at right angles, with the lengths of the first three divided out, and their mean; else as given.

    Returns 1 as the mean length of what is no such matrix, for `checked` to complain.
    """
    try:
        matrix = np.array(pose, np.float64)
    except (TypeError, ValueError):
        return pose, 1.0
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        return pose, 1.0
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not (SMALLEST < lengths).all() or not (lengths < 1 / SMALLEST).all():
        return pose, 1.0
    turned = matrix[:3, :3] / lengths
    if np.abs(turned.T @ turned - np.eye(3)).max() > 1e-3:
        return pose, 1.0
    matrix[:3, :3] = turned
    return matrix, float(lengths.mean())


def checked(pose: ArrayLike, *, where: object, tolerance: float = 1e-3) -> Matrix:
    """`pose` as a (4, 4) float64 rigid transform, its rotation projected to the nearest orthonormal one.

    Raises:
        DatasetError: wrong shape, not finite, left-handed, or further than `tolerance` from orthonormal.
    """
    try:
        matrix = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        raise DatasetError("pose is not a matrix of numbers", where=where) from None
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise DatasetError("pose is not 4x4", where=where, why=f"shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise DatasetError("pose is not finite", where=where, why="it holds NaN or infinity", remedy="drop the frame")
    if np.abs(matrix).max() > FURTHEST:
        why = f"it holds {np.abs(matrix).max():.3g}"
        raise DatasetError("pose is out of range", where=where, why=why, remedy="drop the frame")
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    if np.linalg.det(matrix[:3, :3]) < 0:
        why, remedy = "its determinant is negative", "check the axis convention of the file"
        raise DatasetError("pose is left-handed", where=where, why=why, remedy=remedy)
    error = np.abs(u @ vt - matrix[:3, :3]).max()
    if error > tolerance:
        lengths = ", ".join(f"{length:.4g}" for length in np.linalg.norm(matrix[:3, :3], axis=0))
        why = f"rotation is {error:.3g} away from orthonormal; its columns have the lengths {lengths}"
        remedy = "write rotations without scale or shear"
        raise DatasetError("pose is not a rotation and a translation", where=where, why=why, remedy=remedy)
    return rigid(u @ vt, matrix[:3, 3])
