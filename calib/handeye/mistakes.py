"""Common mistakes in arm poses, recognised by what would make arm and pictures agree.

Each mistake is undone in turn. If the poses then fit the pictures many times better, the mistake is reported.
"""

from itertools import product

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import closed_forms
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError

BETTER = 5.0  # factor by which undoing a mistake must improve the agreement of the views
POOR = 0.02  # no mistake is suspected if the median disagreement of the views, in units of the distance they cover, is below this
FITS = 0.05  # a mistake explains the disagreement if it falls below this when undone: some arms scatter by a fiftieth
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def _turned(stand_from_mount: Array, wxyz: Array) -> Array:
    return np.stack([pose.from_quaternion(q, t) for q, t in zip(wxyz, stand_from_mount[:, :3, 3], strict=True)])


def _orientations(given: Array) -> dict[str, Array]:
    """The poses, by the mistake in orientation that was undone."""
    quaternions, vectors = pose.quaternion(given), pose.rotation_vector(given)
    transposed = pose.rigid(np.swapaxes(given[:, :3, :3], 1, 2), given[:, :3, 3])
    found = {
        "": given,
        "the arm's poses are inverse (flange_from_base instead of base_from_flange)": pose.inverse(given),
        "the arm's rotations are transposed (columns read as rows)": transposed,
        "quaternions are x y z w, but were read as w x y z": _turned(given, np.roll(quaternions, 1, -1)),
        "quaternions are w x y z, but were read as x y z w": _turned(given, np.roll(quaternions, -1, -1)),
        "the arm's axes are left-handed": _MIRROR @ given @ _MIRROR,
    }
    if np.linalg.norm(vectors, axis=1).max() < np.deg2rad(4):
        found["angles are radians, but were read as degrees"] = pose.from_rotation_vector(np.rad2deg(vectors), given[:, :3, 3])
    return found


LENGTHS = {
    "": 1.0,
    "the arm's positions are in millimetres, not metres": 1e-3,
    "lengths of arm and target differ by a factor of 1000: the target is in mm, or the arm's positions were divided by 1000": 1e3,
}


def explain(stand_from_mount: Array, camera_from_board: Array) -> None:
    """Raise a CalibrationError that names the mistake, if one explains why arm and pictures disagree."""
    found = recognise(stand_from_mount, camera_from_board)
    if found:
        why, remedy = f"it looks as if {found}", "correct the poses and run again"
        raise CalibrationError("pictures and arm poses do not fit together", why=why, remedy=remedy)


def recognise(stand_from_mount: Array, camera_from_board: Array) -> str:
    """The mistake that explains best why (views, 4, 4) poses as given and as seen disagree, in words; empty if there is none."""
    given = disagreement(stand_from_mount, camera_from_board)
    if given < POOR:
        return ""
    scores = {}
    for (words, poses), (length_words, factor) in product(_orientations(stand_from_mount).items(), LENGTHS.items()):
        if words or length_words:
            scaled = pose.rigid(poses[:, :3, :3], factor * poses[:, :3, 3])
            scores["; and ".join(w for w in (words, length_words) if w)] = disagreement(scaled, camera_from_board)
    # the simplest first: a combination must be better still
    best = min(scores, key=lambda words: scores[words] * (1 + words.count("; and ")))
    return best if scores[best] * BETTER < given and scores[best] < FITS else ""


def disagreement(stand_from_mount: Array, camera_from_board: Array) -> float:
    """Median disagreement of the views about the board's place, the arm's travel being 1 (and half a radian of rotation)."""
    scale = max(1e-9, *(np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0)) for poses in (stand_from_mount, camera_from_board)))
    best = np.inf
    for method in ("park", "shah"):
        try:
            answer = closed_forms.solve(stand_from_mount, camera_from_board, method)
        except KoalaError:
            continue
        each = np.hypot(answer.translation_residual_m / scale, 2 * answer.rotation_residual_rad)
        best = min(best, float(np.median(each)))
    return best
