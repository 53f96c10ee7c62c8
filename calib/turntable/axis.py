"""The axis of a turntable and its uncertainty, from the corners of a board that turns with it.

The camera's poses in the base are known from the hand-eye calibration. With the board at base_from_board where the table is at
angle zero, corner k of view i is predicted at

    project(inverse(base_from_camera[i]) @ base_from_object(angle[i]) @ base_from_board @ point[k]).

A closed form gives the start: for two views i and j of the board's poses B, the rotation of B[j] @ inverse(B[i]) is that of the
table by angle[j] - angle[i], and its translation (I - R) @ point. Least squares over all corners refines the axis (two tilts, two
shifts) and the board's pose. The covariance counts the noise of corners, and what errors of the hand-eye pose and of the arm's
poses do to the axis: the first is common to all views, the second to the views in which the arm stands at one place.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from koala3d.calib.arrays import Array, Indices
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.intrinsics import estimate, fitting, projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.turntable import Axis

LEAST_TURN_RAD = float(np.deg2rad(20))  # of the table, between any two views
FEWEST_VIEWS = 4
FAR_RAD = float(np.deg2rad(2))  # the table turned by another angle than reported, in the median of neighbouring views
OUTLIER = 6.0  # corners with larger residuals are left out [sigmas]
PLACE_M, PLACE_RAD = 1e-4, 1e-4  # poses of the arm that differ by less are one place
STEP = 1e-6  # of finite differences [m, rad]
TWISTS = np.eye(6)


@dataclass(frozen=True)
class FoundAxis:
    """The axis and how well it explains the corners."""

    axis: Axis
    base_from_board: Array  # (4, 4) with the table at angle zero [m]
    rms_px: float
    view_rms_px: dict[str, float]
    corners: int
    scale: float  # how far the table truly turns for each reported radian
    scale_std: float


@dataclass(frozen=True)
class _Measured:
    """Corners of all views in one list, and what is known of each view."""

    calibration: Calibration
    base_from_camera: Array  # (views, 4, 4)
    angles: Array  # (views,) of the table [rad]
    view: Indices  # (n,)
    pixels: Array  # (n, 2)
    points: Array  # (n, 3) on the board [m]

    def residuals(self, axis: Axis, base_from_board: Array, scale: float = 1.0) -> Array:
        """(n, 2) predicted minus seen [px]."""
        moved = pose.inverse(self.base_from_camera) @ axis.base_from_object(scale * self.angles) @ base_from_board
        inside = np.einsum("nij,nj->ni", moved[self.view, :3, :3], self.points) + moved[self.view, :3, 3]
        camera = self.calibration.camera
        return projection.project(inside, projection.vector(camera), projection.form(camera))[0] - self.pixels


def find(session: TargetSession, angles: Array, calibration: Calibration) -> FoundAxis:
    """The axis from the views of a session.

    Args:
        angles: (views,) of the table in the order of `session.observations` [rad].
        calibration: of the rig, with a hand-eye pose.

    Raises:
        Unobservable: too few views, or the table hardly turned.
        CalibrationError: the board did not turn as reported.
        DatasetError: there is no hand-eye pose.
    """
    turned = float(np.ptp(angles)) if len(angles) else 0.0
    if len(angles) < FEWEST_VIEWS or turned < LEAST_TURN_RAD:
        why = f"{len(angles)} views of the board over {np.degrees(turned):.0f} degrees"
        remedy = f"take at least {FEWEST_VIEWS} views over {np.degrees(LEAST_TURN_RAD):.0f} degrees, better a whole turn"
        raise Unobservable("the views do not show the turntable's axis", why=why, remedy=remedy)
    joints = session.base_from_flange[:, 0, :0] if session.joints is None else session.joints
    cameras = calibration.camera_pose(session.base_from_flange, joints)
    boards = cameras @ estimate.camera_from_boards(calibration.camera, session.observations)
    axis = _closed_form(boards, angles)
    corners = fitting.flat(session.observations)
    measured = _Measured(calibration, cameras, angles, corners.view, corners.pixels, corners.points)
    start = np.median([_flat(pose.inverse(axis.base_from_object(a)) @ b) for a, b in zip(angles, boards, strict=True)], axis=0)
    board = pose.checked(np.vstack([start.reshape(3, 4), [0, 0, 0, 1]]), where="board on the turntable", tolerance=0.5)
    fitted = _Fit(measured, axis, board)
    solution, kept = fitted.solve()
    return fitted.found(solution, kept, session)


def _flat(matrix: Array) -> Array:
    return matrix[:3].ravel()


def _closed_form(boards: Array, angles: Array) -> Axis:
    """The axis by (views, 4, 4) poses of the board in the base. Raises CalibrationError where they contradict the angles."""
    first, second = np.triu_indices(len(boards), 1)
    between = angles[second] - angles[first]
    wrapped = (between + np.pi) % (2 * np.pi) - np.pi
    told = (np.abs(wrapped) > LEAST_TURN_RAD / 2) & (np.abs(wrapped) < np.pi - 0.1)
    if not told.any():
        raise Unobservable("the views do not show the turntable's axis", why="no two differ by 10 to 174 degrees")
    motion = boards[second[told]] @ pose.inverse(boards[first[told]])
    vectors = Rotation.from_matrix(motion[:, :3, :3]).as_rotvec()
    directions = vectors / wrapped[told, None]
    direction = np.median(directions, axis=0)
    length = float(np.linalg.norm(direction))
    off = np.median(np.linalg.norm(vectors - wrapped[told, None] * direction / max(length, 1e-9), axis=1))
    if abs(length - 1) > 0.2 or off > FAR_RAD:
        why = f"it turned by {length:.2f} of the reported angles" if abs(length - 1) > 0.2 else f"{np.degrees(off):.1f} deg off"
        remedy = "check turntable.units_per_turn and turntable.reversed; the board must not slip on the table"
        raise CalibrationError("the board did not turn as the table reported", why=why, remedy=remedy)
    direction /= length
    away = (np.eye(3) - motion[:, :3, :3]).reshape(-1, 3)
    across = np.eye(3) - np.outer(direction, direction)
    place = np.linalg.lstsq(away @ across, motion[:, :3, 3].ravel(), rcond=None)[0]
    middle = np.median(boards[:, :3, 3], axis=0)
    return Axis(across @ place + direction * (direction @ middle), direction, np.zeros((6, 6)))


class _Fit:
    """Least squares over the corners from a start. Unknowns: two shifts [m], two tilts [rad], the board's twist [m, rad]."""

    def __init__(self, measured: _Measured, axis: Axis, board: Array) -> None:
        self.measured, self.start, self.board = measured, axis, board
        helper = np.eye(3)[int(np.abs(axis.direction).argmin())]
        first = np.cross(axis.direction, helper)
        first /= np.linalg.norm(first)
        self.across = np.stack([first, np.cross(axis.direction, first)])  # (2, 3)

    def axis(self, x: Array) -> Axis:
        """The axis after a step (10,)."""
        direction = self.start.direction + x[2:4] @ self.across
        return replace(self.start, point=self.start.point + x[:2] @ self.across, direction=direction / np.linalg.norm(direction))

    def placed(self, x: Array) -> Array:
        """(4, 4) base_from_board after a step."""
        return pose.from_rotation_vector(x[7:10], x[4:7]) @ self.board

    def residuals(self, x: Array, measured: _Measured | None = None) -> Array:
        """(2 n,) [px]; an eleventh unknown is the share by which the table turns further than reported."""
        scale = 1.0 + (x[10] if len(x) > 10 else 0.0)
        return (measured or self.measured).residuals(self.axis(x), self.placed(x), scale).ravel()

    def _some(self, x: Array, rows: Array) -> Array:
        return self.residuals(x)[rows]

    def solve(self) -> tuple[Array, Array]:
        """The step, with corners far off left out, and (n,) which corners are kept."""
        kept, x = np.ones(len(self.measured.pixels), bool), np.zeros(10)
        for _ in range(3):
            rows = np.repeat(kept, 2)
            x = least_squares(self._some, x, x_scale="jac", method="lm", args=(rows,)).x
            size = np.linalg.norm(self.residuals(x).reshape(-1, 2), axis=1)
            limit = OUTLIER * max(float(np.median(size[kept])) / 1.1774, 1e-4)  # median of a Rayleigh distribution
            if (kept == (size < limit)).all():
                break
            kept = size < limit
        return x, kept

    def found(self, x: Array, kept: Array, session: TargetSession) -> FoundAxis:
        """The axis of a solution with its covariance."""
        rows, axis = np.repeat(kept, 2), self.axis(x)
        jacobian = _slopes(self.residuals, x)[rows]
        residuals = self.residuals(x)[rows]
        variance = float(residuals @ residuals) / max(len(residuals) - len(x), 1)
        inverse = np.linalg.inv(jacobian.T @ jacobian)
        covariance = variance * inverse
        gain = -inverse @ jacobian.T
        for slopes, spread in self._nuisances(x, rows):
            moved = gain @ slopes
            covariance = covariance + moved @ spread @ moved.T
        to_axis = _slopes(lambda step: np.concatenate([self.axis(step).point, self.axis(step).direction]), x)
        scaled = _slopes(self.residuals, np.append(x, 0.0))[rows]
        both = np.linalg.inv(scaled.T @ scaled)
        scale, scale_std = float(-(both @ scaled.T @ residuals)[10]), float(np.sqrt(variance * both[10, 10]))
        size = np.linalg.norm(residuals.reshape(-1, 2), axis=1)
        view = self.measured.view[kept]
        by_view = {o.name: _rms(size[view == i]) for i, o in enumerate(session.observations) if (view == i).any()}
        axis = replace(axis, covariance=to_axis @ covariance @ to_axis.T)
        return FoundAxis(axis, self.placed(x), _rms(size), by_view, int(kept.sum()), 1 + scale, scale_std)

    def _nuisances(self, x: Array, rows: Array) -> list[tuple[Array, Array]]:
        """Slopes of the residuals by each error of the camera's poses that views share, and the covariance of that error."""
        measured, calibration = self.measured, self.measured.calibration
        mount = calibration.flange_from_camera
        assert mount is not None  # the camera's poses come from it
        flanges = measured.base_from_camera @ pose.inverse(mount.matrix)

        def by(moved: np.ndarray, chosen: Array) -> Array:
            """(2 n, 6) slopes by a twist of the (views, 4, 4) frames from the left, in the views that are chosen."""
            columns = []
            for twist in TWISTS * STEP:
                step = moved @ pose.from_rotation_vector(twist[3:], twist[:3]) @ pose.inverse(moved) @ measured.base_from_camera
                cameras = np.where(chosen[:, None, None], step, measured.base_from_camera)
                other = replace(measured, base_from_camera=cameras)
                columns.append((self.residuals(x, other) - self.residuals(x))[rows] / STEP)
            return np.stack(columns, axis=1)

        shift_mm = calibration.residuals.arm_translation_mm or 0.05
        turn_deg = calibration.residuals.arm_rotation_deg or 0.01
        arm = np.diag(np.repeat([1e-3 * shift_mm, np.deg2rad(turn_deg)], 3) ** 2)
        found = [(by(flanges, np.ones(len(flanges), bool)), mount.covariance)]
        place = _places(flanges)
        return found + [(by(flanges, place == one), arm) for one in range(int(place.max()) + 1)]


def _places(flanges: Array) -> Indices:
    """(views,) number of the place at which the arm stood, equal where its poses are."""
    numbers = np.full(len(flanges), -1)
    for index in range(len(flanges)):
        if numbers[index] < 0:
            distance, angle = pose.difference(flanges, flanges[index])
            numbers[(distance < PLACE_M) & (angle < PLACE_RAD) & (numbers < 0)] = numbers.max() + 1
    return numbers


def _slopes(function: Callable[[Array], Array], x: Array) -> Array:
    """(m, k) derivatives by central differences."""
    steps = np.eye(len(x)) * STEP
    return np.stack([(function(x + step) - function(x - step)) / (2 * STEP) for step in steps], axis=1)


def _rms(sizes: Array) -> float:
    return float(np.sqrt(np.mean(sizes**2)))
