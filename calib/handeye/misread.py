"""Three angles that mean something else than the description says, recognised by the reading that makes arm and pictures agree.

A rotation vector, and Euler angles about any axes in any order, are three numbers each, and small ones differ little. Between two
views arm and camera turn by the same angle, whatever the pose of the camera on the arm (see `order`). That leaves a few of the
fifty readings. The closed forms decide among these: angles tell neither the names of the axes nor a rotation from its inverse.
"""

from dataclasses import replace

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import flips, mistakes
from koala3d.calib.handeye.order import angles_between
from koala3d.calib.sessions.session import Reading, TargetSession
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError

BETTER = 2.0
"""Factor by which a reading must improve the agreement of the views: no right one of 800 simulated sessions was doubted."""
MOST_VIEWS = 30  # these are enough to tell readings apart
LIKELY = 2.0
"""A reading is looked at if the median difference of the angles between views is within this factor of the smallest one."""


def explain(session: TargetSession, camera_from_board: Array) -> None:
    """Raise a CalibrationError that says how the angles must be read, if that is why arm and pictures disagree."""
    found = recognise(session, camera_from_board)
    if found is not None:
        why, remedy = f"the angles of the poses seem to be {found.kind}", f"say {found.description} in the description"
        raise CalibrationError("pictures and arm poses do not fit together", why=why, remedy=remedy)


def recognise(session: TargetSession, camera_from_board: Array) -> Reading | None:
    """The reading by which arm and (views, 4, 4) poses of the board agree much better than as given; None without one."""
    if not session.readings or len(camera_from_board) < 3:
        return None
    some = np.unique(np.linspace(0, len(camera_from_board) - 1, MOST_VIEWS).astype(int))
    session, camera_from_board = session.chosen(np.isin(np.arange(len(camera_from_board)), some)), camera_from_board[some]
    cameras = [angles_between(camera_from_board, other) for other in flips.readings(session, camera_from_board)]
    views = np.triu_indices(len(camera_from_board), 1)

    def differ(base_from_flange: Array) -> float:
        arm = angles_between(base_from_flange)
        return float(np.median(np.min([np.abs(arm - camera) for camera in cameras], axis=0)[views]))

    angles = {reading: differ(reading.base_from_flange) for reading in session.readings}
    limit = LIKELY * min(differ(session.base_from_flange), *angles.values())
    likely = [reading for reading in angles if angles[reading] <= limit]
    scores = {reading: _disagreement(session, reading.base_from_flange, camera_from_board) for reading in likely}
    best = min(scores, key=lambda one: scores[one], default=None)
    if best is None or scores[best] > mistakes.FITS:
        return None
    as_given = _disagreement(session, session.base_from_flange, camera_from_board)
    return best if scores[best] * BETTER < as_given else None


def _disagreement(session: TargetSession, base_from_flange: Array, camera_from_board: Array) -> float:
    """How far views disagree if the arm's poses are these, in the unit of lengths that fits best."""
    other = replace(session, base_from_flange=base_from_flange, readings=())
    try:
        _, boards = flips.resolve(other, camera_from_board)
    except KoalaError:
        return np.inf
    arm = other.stand_from_mount
    scaled = (pose.rigid(arm[:, :3, :3], factor * arm[:, :3, 3]) for factor in mistakes.LENGTHS.values())
    return min(mistakes.disagreement(poses, boards) for poses in scaled)
