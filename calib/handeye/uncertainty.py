"""Uncertainty of the rig, and what a session cannot determine at all.

Covariances are (6, 6) over a left perturbation, translation first, as `datasets.calibration` stores them. They are the
inverse of the information that corners, the arm's accuracy and known intrinsics give together, with the arm's errors independent
from view to view. `calib.handeye.repeating` adds what repeats.
"""

import numpy as np

from koala3d.calib.arrays import Array
from koala3d.calib.errors import Unobservable
from koala3d.calib.handeye import surface
from koala3d.calib.handeye.model import Measurements
from koala3d.calib.handeye.refine import Refined
from koala3d.calib.intrinsics import estimate, projection
from koala3d.datasets import pose
from koala3d.datasets.calibration import UncertainPose

MIN_TURN_RAD = float(np.deg2rad(3))  # rms angle about an axis below which the flange counts as not having turned about it
MAX_STD_M, MAX_STD_RAD = 5e-3, float(np.deg2rad(1))
"""A pose less certain than this is useless for a reconstruction and refused, unless another bound is asked for on purpose."""
ON_PURPOSE = "for an arm that is no better, --allow-mm accepts more"


def check_motion(base_from_flange: Array) -> None:
    """Raise Unobservable where the arm's motion cannot determine the hand-eye pose, whatever the pictures show.

    Args:
        base_from_flange: (views, 4, 4).

    With rotations about one axis only, camera and board may slide along that axis together; without rotation, by any
    vector (Tsai 1989, section II-C; Park 1994, section III: two axes that are not parallel are needed).
    """
    if len(base_from_flange) < 3:
        why = f"{len(base_from_flange)} views"
        raise Unobservable("hand-eye pose is not observable", why=why, remedy="record at least 10 views")
    first, second = np.triu_indices(len(base_from_flange), 1)  # all pairs of views
    rotations = base_from_flange[:, :3, :3]
    turns = pose.rotation_vector(rotations[first] @ np.swapaxes(rotations[second], 1, 2))
    _, spread, axes = np.linalg.svd(turns / np.sqrt(len(turns)), full_matrices=False)
    if spread[0] < MIN_TURN_RAD:
        why = f"the flange turned by {np.rad2deg(spread[0]):.2g} deg only"
        remedy = "tilt the camera by 20 degrees and more about two different axes between views"
        raise Unobservable("translation of the hand-eye pose is not observable", why=why, remedy=remedy)
    if spread[1] < MIN_TURN_RAD:
        axis = ", ".join(f"{x:.2f}" for x in axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()]))
        what = "translation of the hand-eye pose along the axis of rotation is not observable"
        why = f"the flange turned about ({axis}) in the base, and by only {np.rad2deg(spread[1]):.2g} deg about other axes"
        raise Unobservable(what, why=why, remedy="add views that are tilted about a second axis by 20 degrees and more")


def parameter_names(session: Measurements) -> list[str]:
    """Names of the global parameters, with units, in the order of `Refined.information`."""
    axes = [f"{kind} {axis}" for kind in ("translation", "rotation") for axis in "xyz"]
    of_links = [session.links.parameters[one] for one in session.erring]
    shape = [surface.NAMES[one] for one in session.shaped]
    return [*session.free, *of_links, *shape, *(f"{p} {a}" for p in session.pose_names for a in axes)]


def covariance(session: Measurements, refined: Refined, allow_m: float = MAX_STD_M) -> Array:
    """(p, p) covariance of the global parameters. Raises Unobservable, naming the worst one, where they are undetermined.

    `allow_m` is the largest standard deviation of a position that is not refused; that of a rotation grows with it.
    """
    information = refined.information
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if not np.isfinite(values).all() or values[0] < 1e-14 * values[-1]:
        weakest = np.abs(vectors[:, 0] / scale) / _units(session)
        _refuse(session, int(weakest.argmax()), "no view shows it")
    return checked(session, refined, (vectors / values) @ vectors.T / np.outer(scale, scale), allow_m)


def poses(session: Measurements, refined: Refined, joint: Array) -> tuple[UncertainPose, UncertainPose]:
    """(mount_from_camera, stand_from_board) with their (6, 6) covariances out of the `joint` (p, p) one."""
    state = refined.state
    return UncertainPose(state.mount_from_camera, joint[-12:-6, -12:-6]), UncertainPose(state.stand_from_board, joint[-6:, -6:])


def _units(session: Measurements) -> Array:
    """(p,) errors that would matter: scales that make the parameters comparable."""
    of_camera = np.where(np.array(session.columns) < 4, 10.0, 0.1)
    of_links = np.repeat([MAX_STD_M, MAX_STD_RAD], 2 * session.links.count)[session.erring]
    of_shape = np.full(len(session.shaped), MAX_STD_M)  # a share, or metres
    return np.concatenate([of_camera, of_links, of_shape, np.tile(np.repeat([MAX_STD_M, MAX_STD_RAD], 3), 2)])


def checked(session: Measurements, refined: Refined, joint: Array, allow_m: float = MAX_STD_M) -> Array:
    """`joint` (p, p) as given. Raises Unobservable where a pose or the focal length is too uncertain to be of use."""
    std, times = np.sqrt(np.diag(joint)), allow_m / MAX_STD_M
    for name in ("fx", "fy"):
        if name in session.free:
            relative = std[session.free.index(name)] / refined.state.intrinsics[projection.NAMES.index(name)]
            if not relative <= estimate.MAX_FOCAL_STD:
                _refuse(session, session.free.index(name), f"its standard deviation is {relative:.1%} of it")
    for uncertain, first in zip(poses(session, refined, joint), (-12, -6), strict=True):
        millimetres = uncertain.translation_std_mm
        if not millimetres.max() <= 1e3 * MAX_STD_M * times:
            why = f"its standard deviation is {millimetres.max():.3g} mm"
            _refuse(session, first + int(millimetres.argmax()), why, f"; {ON_PURPOSE}")
        if not std[first + 3 :][:3].max() <= MAX_STD_RAD * times:
            worst = first + 3 + int(std[first + 3 :][:3].argmax())
            _refuse(session, worst, f"its standard deviation is {np.rad2deg(std[worst]):.3g} deg", f"; {ON_PURPOSE}")
    return joint


def _refuse(session: Measurements, parameter: int, why: str, more: str = "") -> None:
    remedy = f"add views that are tilted by 20 degrees and more about two axes, at two distances{more}"
    raise Unobservable(f"{parameter_names(session)[parameter]} is not observable", why=why, remedy=remedy)
