"""The rig as equations: where each corner of each view should be seen, and how that changes with every unknown.

Corner k of view i is predicted at

    project(inverse(base_from_flange[i] @ C[i] @ flange_from_camera) @ base_from_board @ point[k])      camera on the flange,
    project(inverse(base_from_camera) @ base_from_flange[i] @ C[i] @ flange_from_board @ point[k])      camera beside the arm,

where C[i] is what the arm's report missed, a small motion of the flange about its own origin. The two unknown poses are called
`camera_pose` (flange_from_camera or base_from_camera) and `board_pose` (base_from_board or flange_from_board) where both are meant.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from calib import projection
from calib.errors import CalibrationError
from calib.geometry import exponential, rotate, rows_cross
from datasets import pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Accuracy:
    """How far the arm's reported flange pose is from the true one: standard deviations per axis."""

    translation_m: float = 5e-5
    rotation_rad: float = float(np.deg2rad(0.01))


@dataclass(frozen=True)
class Known:
    """Intrinsics as measured elsewhere."""

    names: tuple[str, ...]
    values: Array
    """(k,) in the order of `names`."""
    covariance: Array
    """(k, k)."""

    def off(self, intrinsics: Array) -> Array:
        """(k,) deviations of (12,) intrinsics from what is known, whitened: independent and of unit variance."""
        columns = [projection.NAMES.index(name) for name in self.names]
        return self.whitening @ (self.values - intrinsics[columns])

    @property
    def whitening(self) -> Array:
        """(k, k) matrix that makes deviations independent and of unit variance."""
        scale = np.sqrt(np.diag(self.covariance))  # between 1e-6 for k3 and pixels: scaled before it is inverted
        return np.linalg.inv(np.linalg.cholesky(self.covariance / np.outer(scale, scale))) / scale


@dataclass(frozen=True)
class Session:
    """What was measured: corners of all views in one list, and the arm's word for each view."""

    base_from_flange: Array
    """(views, 4, 4) as reported."""
    view: NDArray[np.int64]
    """(n,) view of each corner, ascending."""
    pixels: Array
    """(n, 2) [px]."""
    points: Array
    """(n, 3) on the board [m]."""
    free: tuple[str, ...] = ("fx", "fy", "cx", "cy")
    """Intrinsics that are estimated; the others stay."""
    known: Known | None = None
    """Of `free` intrinsics, from elsewhere."""
    accuracy: Accuracy = Accuracy()
    """The arm's, as stated."""
    fisheye: bool = False
    """Whether the lens is a fisheye."""
    eye_to_hand: bool = False
    """Whether the camera stands beside the arm and the board is on the flange."""

    @property
    def columns(self) -> list[int]:
        """Indices of `free` in the intrinsics vector."""
        return [projection.NAMES.index(name) for name in self.free]

    def some(self, chosen: NDArray[np.bool_]) -> "Session":
        """The same with the corners of `chosen` (n,) alone; views keep their numbers."""
        return replace(self, view=self.view[chosen], pixels=self.pixels[chosen], points=self.points[chosen])


@dataclass(frozen=True)
class State:
    """The unknowns. Global parameters are ordered: free intrinsics, camera_pose (6), board_pose (6).

    With the camera beside the arm, `flange_from_camera` holds base_from_camera and `base_from_board` holds flange_from_board.
    """

    intrinsics: Array
    """(12,) in the order of `projection.NAMES`."""
    flange_from_camera: Array
    """(4, 4); perturbed from the left, translation first."""
    base_from_board: Array
    """(4, 4); perturbed from the left, translation first."""
    corrections: Array
    """(views, 6): translation [m] and rotation vector [rad] of C[i]."""

    def moved(self, columns: list[int], step: Array, view_steps: Array) -> Self:
        """The state after a step of (len(columns) + 12,) global parameters and (views, 6) corrections."""
        intrinsics = self.intrinsics.copy()
        intrinsics[columns] += step[:-12]
        return replace(
            self, intrinsics=intrinsics, flange_from_camera=perturbed(self.flange_from_camera, step[-12:-6]),
            base_from_board=perturbed(self.base_from_board, step[-6:]), corrections=self.corrections + view_steps,
        )  # fmt: skip


def perturbed(a_from_b: Array, twist: Array) -> Array:
    """`a_from_b` after a small motion of b's frame in a: translation by twist[:3] and rotation by twist[3:], about a's origin."""
    return pose.from_rotation_vector(twist[3:], twist[:3]) @ a_from_b


def predict(session: Session, state: State) -> tuple[Array, Array, Array]:
    """Predicted corners and their derivatives.

    Returns:
        (n, 2) pixels; (n, 2, p) by the global parameters; (n, 2, 6) by the correction of the corner's own view.
    """
    rotation, right_jacobian = exponential(state.corrections[:, 3:])
    chain = (_beside if session.eye_to_hand else _on_flange)(session, state, rotation)
    if not chain.in_camera[:, 2].min() > 1e-6:
        raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")
    pixels, by_camera, by_intrinsics = projection.project(chain.in_camera, state.intrinsics, session.fisheye)
    camera_pose, board_pose, own = chain.derivatives(by_camera, right_jacobian[session.view])
    return pixels, np.concatenate([by_intrinsics[..., session.columns], camera_pose, board_pose], -1), own


def camera_points(session: Session, state: State) -> Array:
    """(n, 3) corners in the camera frame of their view [m]."""
    rotation, _ = exponential(state.corrections[:, 3:])
    return (_beside if session.eye_to_hand else _on_flange)(session, state, rotation).in_camera


@dataclass(frozen=True)
class _OnFlange:
    """Corners (n, 3) in the frames from board to camera [m], and the rotations between them; the camera is on the flange."""

    in_base: Array
    in_flange: Array
    in_camera: Array
    camera_from_flange: Array
    true_from_reported: Array
    """(n, 3, 3) rotations of the flange's correction, undone."""
    flange_from_base: Array
    """(n, 3, 3), as reported."""

    def derivatives(self, by_camera: Array, right_jacobian: Array) -> tuple[Array, Array, Array]:
        """(n, 2, 6) derivatives by camera_pose, board_pose and correction, from those (n, 2, 3) by the point in the camera."""
        by_flange = by_camera @ self.camera_from_flange
        by_reported = by_flange @ self.true_from_reported
        by_base = by_reported @ self.flange_from_base
        turning = rows_cross(by_flange, self.in_flange)
        camera_pose = np.concatenate([-by_flange, turning], -1)
        board_pose = np.concatenate([by_base, -rows_cross(by_base, self.in_base)], -1)
        return camera_pose, board_pose, np.concatenate([-by_reported, turning @ right_jacobian], -1)


def _on_flange(session: Session, state: State, correction: Array) -> _OnFlange:
    flange_from_base = pose.inverse(session.base_from_flange)[session.view]
    camera_from_flange = pose.inverse(state.flange_from_camera)
    back = np.swapaxes(correction, 1, 2)[session.view]
    in_base = session.points @ state.base_from_board[:3, :3].T + state.base_from_board[:3, 3]
    reported = rotate(flange_from_base[:, :3, :3], in_base) + flange_from_base[:, :3, 3]
    in_flange = rotate(back, reported - state.corrections[session.view, :3])
    in_camera = in_flange @ camera_from_flange[:3, :3].T + camera_from_flange[:3, 3]
    return _OnFlange(in_base, in_flange, in_camera, camera_from_flange[:3, :3], back, flange_from_base[:, :3, :3])


@dataclass(frozen=True)
class _Beside:
    """The same with the camera beside the arm and the board on the flange."""

    in_flange: Array
    in_base: Array
    in_camera: Array
    camera_from_base: Array
    base_from_flange: Array
    """(n, 3, 3), as reported."""
    correction: Array
    """(n, 3, 3)."""

    def derivatives(self, by_camera: Array, right_jacobian: Array) -> tuple[Array, Array, Array]:
        """As of `_OnFlange`."""
        by_base = by_camera @ self.camera_from_base
        by_reported = by_base @ self.base_from_flange
        by_flange = by_reported @ self.correction
        turning = -rows_cross(by_flange, self.in_flange)
        camera_pose = np.concatenate([-by_base, rows_cross(by_base, self.in_base)], -1)
        return camera_pose, np.concatenate([by_flange, turning], -1), np.concatenate([by_reported, turning @ right_jacobian], -1)


def _beside(session: Session, state: State, correction: Array) -> _Beside:
    base_from_flange, turns = session.base_from_flange[session.view], correction[session.view]
    camera_from_base = pose.inverse(state.flange_from_camera)
    in_flange = session.points @ state.base_from_board[:3, :3].T + state.base_from_board[:3, 3]
    reported = rotate(turns, in_flange) + state.corrections[session.view, :3]
    in_base = rotate(base_from_flange[:, :3, :3], reported) + base_from_flange[:, :3, 3]
    in_camera = in_base @ camera_from_base[:3, :3].T + camera_from_base[:3, 3]
    return _Beside(in_flange, in_base, in_camera, camera_from_base[:3, :3], base_from_flange[:, :3, :3], turns)
