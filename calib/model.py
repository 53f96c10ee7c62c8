"""The rig as equations: where each corner of each view should be seen, and how that changes with every unknown.

Corner k of view i is predicted at

    project(inverse(base_from_flange[i] @ C[i] @ flange_from_camera) @ base_from_board @ point[k]),

where C[i] is what the arm's report missed, a small motion of the flange about its own origin.
"""

from dataclasses import dataclass, field, replace
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
    known: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Value and standard deviation of intrinsics measured elsewhere."""
    accuracy: Accuracy = Accuracy()
    """The arm's, as stated."""

    @property
    def columns(self) -> list[int]:
        """Indices of `free` in the intrinsics vector."""
        return [projection.NAMES.index(name) for name in self.free]

    def some(self, chosen: NDArray[np.bool_]) -> "Session":
        """The same with the corners of `chosen` (n,) alone; views keep their numbers."""
        return replace(self, view=self.view[chosen], pixels=self.pixels[chosen], points=self.points[chosen])


@dataclass(frozen=True)
class State:
    """The unknowns. Global parameters are ordered: free intrinsics, flange_from_camera (6), base_from_board (6)."""

    intrinsics: Array
    """(9,) in the order of `projection.NAMES`."""
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
    flange_from_base = pose.inverse(session.base_from_flange)[session.view, :3, :3]
    correction_rotation, right_jacobian = exponential(state.corrections[:, 3:])
    back = np.swapaxes(correction_rotation, 1, 2)[session.view]  # true flange from reported flange, rotation
    camera_from_flange = pose.inverse(state.flange_from_camera)
    in_base, in_flange, in_camera = _chain(session, state, back)
    if not in_camera[:, 2].min() > 1e-6:
        raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")

    pixels, by_camera, by_intrinsics = projection.project(in_camera, state.intrinsics)
    by_flange = by_camera @ camera_from_flange[:3, :3]
    by_base = by_flange @ (back @ flange_from_base)
    hand_eye = np.concatenate([-by_flange, rows_cross(by_flange, in_flange)], -1)
    board = np.concatenate([by_base, -rows_cross(by_base, in_base)], -1)
    own = np.concatenate([-by_flange @ back, rows_cross(by_flange, in_flange) @ right_jacobian[session.view]], -1)
    return pixels, np.concatenate([by_intrinsics[..., session.columns], hand_eye, board], -1), own


def camera_points(session: Session, state: State) -> Array:
    """(n, 3) corners in the camera frame of their view [m]."""
    correction_rotation, _ = exponential(state.corrections[:, 3:])
    return _chain(session, state, np.swapaxes(correction_rotation, 1, 2)[session.view])[-1]


def _chain(session: Session, state: State, back: Array) -> tuple[Array, Array, Array]:
    """(n, 3) corners in the base, in the true flange and in the camera [m]; `back` are the corrections' inverse rotations."""
    flange_from_base = pose.inverse(session.base_from_flange)[session.view]
    camera_from_flange = pose.inverse(state.flange_from_camera)
    in_base = session.points @ state.base_from_board[:3, :3].T + state.base_from_board[:3, 3]
    reported = rotate(flange_from_base[:, :3, :3], in_base) + flange_from_base[:, :3, 3]
    in_flange = rotate(back, reported - state.corrections[session.view, :3])
    return in_base, in_flange, in_flange @ camera_from_flange[:3, :3].T + camera_from_flange[:3, 3]
