"""The rig as equations: where each corner of each view should be seen, and how that changes with every unknown.

The flange of view i is truly at

    flange[i] = base_from_flange[i] @ D(q[i], errors) @ C[i],

where D is the motion of the flange due to errors of the links (true minus nominal parameters, among them the offsets of the
joints), and C[i] is the remaining error of the report: a small motion of the flange about its own origin. Corner k of that view
is predicted at

    project(inverse(flange[i] @ flange_from_camera) @ base_from_board @ point[k])      camera on the flange,
    project(inverse(base_from_camera) @ flange[i] @ flange_from_board @ point[k])      camera beside the arm.

Both are one equation. The `mount` carries the camera: it is the flange, or the base if the camera stands beside the arm. The
`stand` carries the board: it is the base, or the flange. Corner k is then predicted at

    project(inverse(mount_from_camera) @ mount_from_stand[i] @ stand_from_board @ point[k]),

where mount_from_stand[i] is inverse(flange[i]) or flange[i]. A small motion of the flange is one of what is mounted on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from koala3d.calib.arrays import Array, Indices, Mask
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import surface
from koala3d.calib.intrinsics import fitting, projection
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.calib.intrinsics.projection import PLAIN, Form
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.solver.geometry import by_motion, exponential, rotate
from koala3d.datasets import kinematics, pose
from koala3d.datasets.kinematics import UR5E, Links


@dataclass(frozen=True)
class Accuracy:
    """How far arm and target are from what they are taken for: standard deviations."""

    translation_m: float = 5e-5  # of the reported flange pose, per axis
    rotation_rad: float = float(np.deg2rad(0.01))
    joint_rad: float = 0.0  # of each joint's offset, which is the same in all views; 0: as `angle_rad`
    length_m: float = 0.0  # of the lengths d and a of each link; 0: they are exact
    angle_rad: float = 0.0  # of the angles alpha and theta of each link; 0: they are exact
    stretch: float = 0.0  # of the print's lengths along x and y, as a share; 0: it is exact
    sag_m: float = 0.0  # of the target's middle over its edges; 0: it is flat

    def to_json(self) -> dict[str, float]:
        """Plain dictionary with the units of the command line."""
        return {
            "translation_mm": 1e3 * self.translation_m,
            "rotation_deg": float(np.rad2deg(self.rotation_rad)),
            "joint_deg": float(np.rad2deg(self.joint_rad)),
            "link_mm": 1e3 * self.length_m,
            "link_deg": float(np.rad2deg(self.angle_rad)),
            "print_percent": 100 * self.stretch,
            "sag_mm": 1e3 * self.sag_m,
        }


@dataclass(frozen=True)
class Measurements:
    """What was measured: corners of all views in one list, and the arm's report for each view."""

    base_from_flange: Array  # (views, 4, 4) as reported
    view: Indices  # (n,) view of each corner, ascending
    pixels: Array  # (n, 2) [px]
    points: Array  # (n, 3) on the board [m]
    free: tuple[str, ...] = ("fx", "fy", "cx", "cy")
    known: IntrinsicsPrior | None = None  # of `free` intrinsics, from elsewhere
    accuracy: Accuracy = Accuracy()  # the arm's, as stated
    form: Form = PLAIN  # of the lens
    eye_to_hand: bool = False  # whether the camera stands beside the arm and the board is on the flange
    joints: Array | None = None  # (views, n) joint angles as reported [rad], where they are known
    links: Links = UR5E  # the arm's nominal chain, with n joints
    extent: Array | None = None  # (2, 2) of the target, see `surface.extent_of`; None: that of the corners

    @property
    def shaped(self) -> list[int]:
        """Which numbers of the target's `shape` are estimated."""
        return [0, 1] * (self.accuracy.stretch > 0) + [2, 3] * (self.accuracy.sag_m > 0)

    @property
    def link_std(self) -> Array:
        """(4 n,) stated deviations of d, a [m], alpha, theta [rad]; 0 where no error is estimated.

        Errors of d and theta of the first link move the whole base, all of the last link move the flange: the two unknown poses
        absorb them exactly, so they are zero by convention.
        """
        accuracy, count = self.accuracy, self.links.count
        if self.joints is None:
            return np.zeros(4 * count)
        kinds = (accuracy.length_m, accuracy.length_m, accuracy.angle_rad, accuracy.joint_rad or accuracy.angle_rad)
        found = np.repeat(np.array(kinds)[:, None], count, axis=1)
        found[:, -1], found[[0, 3], 0] = 0.0, 0.0
        return found.ravel()

    @property
    def erring(self) -> list[int]:
        """Which of the 4 n parameters of the links have errors that are estimated."""
        return np.flatnonzero(self.link_std).tolist()

    @property
    def pose_names(self) -> tuple[str, str]:
        """What mount_from_camera and stand_from_board are in this session."""
        return ("base_from_camera", "flange_from_board") if self.eye_to_hand else ("flange_from_camera", "base_from_board")

    @property
    def columns(self) -> list[int]:
        """Indices of `free` in the intrinsics vector."""
        return projection.columns(self.free)

    def some(self, chosen: Mask) -> "Measurements":
        """The same with the corners of `chosen` (n,) alone; views keep their numbers."""
        return replace(self, view=self.view[chosen], pixels=self.pixels[chosen], points=self.points[chosen])

    def predicted(self, state: "State") -> tuple[Array, Array, Array]:
        """See `predict`."""
        return predict(self, state)

    def moved(self, state: "State", step: Array, view_steps: Array) -> "State":
        """`state` after a step of the global unknowns and the (views, 6) corrections."""
        counts = [len(self.free), len(self.erring), len(self.shaped), 6]
        of_camera, of_links, of_shape, of_mount, of_board = np.split(step, np.cumsum(counts))
        intrinsics, errors, shape = state.intrinsics.copy(), state.link_errors.copy(), state.shape.copy()
        intrinsics[self.columns] += of_camera
        errors[self.erring] += of_links
        shape[self.shaped] += of_shape
        mount, board = perturbed(state.mount_from_camera, of_mount), perturbed(state.stand_from_board, of_board)
        return State(intrinsics, mount, board, state.corrections + view_steps, errors, shape)

    def known_rows(self, state: "State") -> Array:
        """(k, p + 1) what is known of the global unknowns, whitened: derivatives, and the deviation of `state` from it.

        The last rows are those of links and target, one for each unknown.
        """
        names, erring, shaped, known = self.free, self.erring, self.shaped, self.known
        own = len(erring) + len(shaped)
        rows = np.zeros((own, len(names) + own + 13))
        std = [*self.link_std[erring], *([self.accuracy.stretch, self.accuracy.sag_m][one // 2] for one in shaped)]
        rows[range(own), range(len(names), len(names) + own)] = 1.0
        rows[:, -1] = -np.concatenate([state.link_errors[erring], state.shape[shaped]])
        rows /= np.array(std)[:, None]
        if known is None:
            return rows
        of_camera = np.zeros((len(known.names), rows.shape[1]))
        of_camera[:, [*range(len(names)), -1]] = known.rows(names, state.intrinsics)
        return np.vstack([of_camera, rows])

    @cached_property
    def by_shape(self) -> Array:
        """(n, 3, 4) derivatives of the corners on the target by its shape."""
        return surface.by_shape(self.points, surface.extent_of(self.points) if self.extent is None else self.extent)


def measured(
    session: TargetSession, free: Sequence[str], known: IntrinsicsPrior | None, accuracy: Accuracy, form: Form = PLAIN
) -> Measurements:
    """All corners of a target session in one list."""
    extent = surface.extent_of(session.board.points)
    options = (tuple(free), known, accuracy, form, session.eye_to_hand, session.joints, session.links, extent)
    return Measurements(session.base_from_flange, *fitting.flat(session.observations), *options)


@dataclass(frozen=True)
class State:
    """The unknowns.

    Order of the global ones: free intrinsics, errors of the links, shape of the target, mount_from_camera (6),
    stand_from_board (6).
    """

    intrinsics: Array  # in the order of `calib.intrinsics.projection`
    mount_from_camera: Array  # (4, 4); perturbed from the left, translation first
    stand_from_board: Array  # (4, 4); perturbed from the left, translation first
    corrections: Array  # (views, 6): translation [m] and rotation vector [rad] of C[i]
    link_errors: Array = field(default_factory=lambda: np.zeros(24))  # (4 n,) of d, a [m], alpha, theta [rad]
    shape: Array = field(default_factory=surface.FLAT.copy)  # (4,) of the target, see `calib.handeye.surface`


def perturbed(a_from_b: Array, twist: Array) -> Array:
    """`a_from_b` after a small motion of b's frame in a: translation by twist[:3] and rotation by twist[3:], about a's origin."""
    return pose.from_rotation_vector(twist[3:], twist[:3]) @ a_from_b


def predict(session: Measurements, state: State) -> tuple[Array, Array, Array]:
    """Predicted corners and their derivatives.

    Returns:
        (n, 2) pixels; (n, 2, p) by the global parameters; (n, 2, 6) by the correction of the corner's own view.
    """
    chain, view = _chain(session, state), session.view
    if not chain.in_camera[:, 2].min(initial=np.inf) > 1e-6:
        raise CalibrationError("target comes to lie behind the camera", why="the start is too far from the answer")
    pixels, by_camera, by_intrinsics = projection.project(chain.in_camera, state.intrinsics, session.form)
    by_mount = by_camera @ chain.camera_from_mount
    by_stand = by_mount @ chain.mount_from_stand[view]
    by_camera_pose = -by_motion(by_mount, chain.on_mount)
    by_board_pose = by_motion(by_stand, chain.on_stand)
    by_flange = by_board_pose if session.eye_to_hand else by_camera_pose
    rotation, right_jacobian = exponential(state.corrections[:, 3:])
    own = np.concatenate([by_flange[..., :3] @ np.swapaxes(rotation, 1, 2)[view], by_flange[..., 3:] @ right_jacobian[view]], -1)
    by_links = by_flange @ _link_motions(session, state, rotation)[view]
    by_global = [by_intrinsics[..., session.columns], by_links, by_camera_pose, by_board_pose]
    if session.shaped:
        by_global.insert(2, by_stand @ state.stand_from_board[:3, :3] @ session.by_shape[..., session.shaped])
    return pixels, np.concatenate(by_global, -1), own


def camera_points(session: Measurements, state: State) -> Array:
    """(n, 3) corners in the camera frame of their view [m]."""
    return _chain(session, state).in_camera


@dataclass(frozen=True)
class _Chain:
    """Corners (n, 3) in the frames from board to camera [m], and the rotations between what carries the two."""

    on_stand: Array
    on_mount: Array
    in_camera: Array
    mount_from_stand: Array  # (views, 3, 3)
    camera_from_mount: Array  # (3, 3)


def _chain(session: Measurements, state: State) -> _Chain:
    rotation, _ = exponential(state.corrections[:, 3:])
    flange = _reported(session, state) @ pose.rigid(rotation, state.corrections[:, :3])
    mounts = flange if session.eye_to_hand else pose.inverse(flange)
    camera_from_mount = pose.inverse(state.mount_from_camera)
    on_board = session.points + session.by_shape @ state.shape if state.shape.any() else session.points
    on_stand = on_board @ state.stand_from_board[:3, :3].T + state.stand_from_board[:3, 3]
    on_mount = rotate(mounts[session.view, :3, :3], on_stand) + mounts[session.view, :3, 3]
    in_camera = on_mount @ camera_from_mount[:3, :3].T + camera_from_mount[:3, 3]
    return _Chain(on_stand, on_mount, in_camera, mounts[:, :3, :3], camera_from_mount[:3, :3])


def _reported(session: Measurements, state: State) -> Array:
    """(views, 4, 4) base_from_flange @ D: the report with errors of the links corrected."""
    if session.joints is None or not state.link_errors.any():
        return session.base_from_flange
    return kinematics.corrected(session.base_from_flange, session.joints, state.link_errors, session.links)


def _link_motions(session: Measurements, state: State, rotation: Array) -> Array:
    """(views, 6, k) motion of the true flange, in its own frame, for a small error of each parameter of `session.erring`.

    The kinematics give that of the reported flange; seen from the flange that `rotation` (views, 3, 3) and the translation of
    its correction lead to, it is turned back, and turning moves what is not at the origin.
    """
    if session.joints is None or not session.erring:
        return np.zeros((len(session.base_from_flange), 6, 0))
    motions = kinematics.link_motions(session.joints, session.links.with_errors(state.link_errors))[..., session.erring]
    moved = motions[:, :3] + np.cross(motions[:, 3:], state.corrections[:, :3, None], axis=1)
    back = np.swapaxes(rotation, 1, 2)
    return np.concatenate([back @ moved, back @ motions[:, 3:]], axis=1)
