"""Chessboards that look the same after half a turn: both numbers of squares are even, or both are odd.

Each view then has two readings, and the arm tells which ones belong together. Whatever the hand-eye pose is, arm and camera
turn by the same angle between two views, and all views must put the board in the same place.
"""

from dataclasses import replace

import numpy as np

from koala3d.calib.arrays import Array, Indices
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import closed_forms
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError


def readings(session: TargetSession, camera_from_board: Array) -> list[Array]:
    """The (views, 4, 4) poses as given; of a board that looks the same after half a turn, those of the other reading too."""
    return [camera_from_board, camera_from_board @ half_turn(session)][: 1 + session.board.is_ambiguous]


def resolve(session: TargetSession, camera_from_board: Array) -> tuple[TargetSession, Array]:
    """The session with all views read the same way round, and their (views, 4, 4) poses; other boards as given.

    Raises CalibrationError where no reading of the views fits the arm.
    """
    if not session.board.is_ambiguous:
        return session, camera_from_board
    both = np.stack(readings(session, camera_from_board))  # (2, views, 4, 4)
    views = np.arange(len(camera_from_board))
    best, best_score = None, np.inf
    for reference in views[: min(len(views), 5)]:
        turned = _by_angle(session.stand_from_mount, both, reference)
        for _ in range(5):
            try:
                answer, keep = closed_forms.solve_robustly(session.stand_from_mount, both[turned, views])
            except KoalaError:
                break
            score = answer.score(keep) / max(keep.mean(), 1e-9)
            if score < best_score:
                best, best_score = turned, score
            following = _by_place(session.stand_from_mount, both, answer.mount_from_camera, answer.stand_from_board)
            if (following == turned).all():
                break
            turned = following
    if best is None:
        remedy = "use a board with an odd number of squares one way and an even number the other"
        raise CalibrationError("chessboard cannot be read the same way round in all views", remedy=remedy)
    return _turned(session, best), both[best, views]


def as_placed(
    session: TargetSession, camera_from_board: Array, mount_from_camera: Array, stand_from_board: Array
) -> tuple[TargetSession, Array]:
    """The same where the calibration is known: every view is read as its poses have the board."""
    if not session.board.is_ambiguous:
        return session, camera_from_board
    both = np.stack(readings(session, camera_from_board))
    chosen = _by_place(session.stand_from_mount, both, mount_from_camera, stand_from_board)
    return _turned(session, chosen), both[chosen, np.arange(len(camera_from_board))]


def _turned(session: TargetSession, turned: Indices) -> TargetSession:
    """The session with the views of which `turned` (views,) is 1 read the other way round."""
    points, last = session.board.points, len(session.board.points) - 1
    pairs = zip(session.observations, turned, strict=True)
    observations = (replace(o, ids=last - o.ids, points=points[last - o.ids]) if other else o for o, other in pairs)
    return replace(session, observations=tuple(observations))


def half_turn(session: TargetSession) -> Array:
    """(4, 4) board_from_turned_board: half a turn about the board's middle."""
    x, y, _ = session.board.points.min(0) + session.board.points.max(0)
    return pose.from_rotation_vector([0, 0, np.pi], [x, y, 0])


def _by_angle(stand_from_mount: Array, both: Array, reference: int) -> Indices:
    """(views,) 1 where the other reading turns by the angle that the arm turned by since the reference view."""
    arm = pose.rotation_angle(pose.inverse(stand_from_mount[reference]) @ stand_from_mount)
    seen = pose.rotation_angle(both @ pose.inverse(both[0, reference]))
    return np.abs(seen - arm).argmin(0)


def _by_place(stand_from_mount: Array, both: Array, mount_from_camera: Array, stand_from_board: Array) -> Indices:
    """(views,) 1 where the other reading puts the board nearer to where the answer has it."""
    distance, angle = pose.difference(stand_from_mount @ mount_from_camera @ both, stand_from_board)
    return np.hypot(distance, 0.5 * angle).argmin(0)
