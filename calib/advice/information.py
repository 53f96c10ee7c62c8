"""What a view would tell before it is taken, and how far off the hand-eye pose may be.

The information of a view follows from where its corners will be seen and from the errors of corners and arm (Pukelsheim 2006,
chapter 1). That of many views is computed at once: with J the derivatives of a view's corners by the global unknowns and K by
the correction of the arm's report, both over the corner's standard deviation, and L the inverse variances of the correction,

    information = J' J - J' K (K' K + L)^-1 K' J.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.handeye import model
from koala3d.calib.handeye.model import Measurements, State
from koala3d.calib.handeye.refine import Sigmas
from koala3d.calib.intrinsics import projection
from koala3d.calib.solver.elimination import covariance_of
from koala3d.datasets import pose
from koala3d.datasets.advice import Figures
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.targets.board import Board

MIN_SHARE = 0.7  # smallest share of the board's corners in a view, and
MIN_CORNERS = 8  # their smallest number on a checkered board
MIN_DEPTH_M = 1e-3  # a view with a corner nearer than this, or behind the camera, shows nothing
CERTAINTY = 0.95  # with which both errors are below the stated figures
_EACH = (1 + CERTAINTY) / 2  # certainty of each figure: together they miss no more often than 1 - CERTAINTY (Bonferroni)
FOLD = 1.4  # points are projected up to this share of the image's corner, measured without distortion
BLOCK = 100  # views computed at once; limits the memory


@dataclass(frozen=True)
class Knowledge:
    """What a session has shown so far, as far as the choice of the next view needs it."""

    camera: Camera
    board: Board
    free: tuple[str, ...]  # intrinsics that are estimated
    state: State  # corrections are not used
    sigmas: Sigmas
    information: Array  # (p, p) of the global unknowns, in the order of `State`
    eye_to_hand: bool = False  # whether the camera stands beside the arm and the board is on the flange


def inside_image(pixels: Array, camera: Camera) -> Mask:
    """(n,) which of (n, 2) pixels lie in the image, two pixels from its border."""
    return np.all((pixels > 2) & (pixels < [camera.width - 2, camera.height - 2]), axis=-1)


def visible(in_camera: Array, pixels: Array, camera: Camera) -> Mask:
    """(n,) which of (n, 3) points in the camera frame [m], projected to (n, 2) pixels, the image shows.

    Far off the axis the distortion's polynomial folds back into the image; such points do not count.
    """
    depth = np.maximum(in_camera[:, 2], MIN_DEPTH_M)
    reach = FOLD * np.hypot(camera.width, camera.height) / 2 / min(camera.fx, camera.fy)
    straight = camera.fisheye | (np.linalg.norm(in_camera[:, :2], axis=1) / depth < reach)
    return inside_image(pixels, camera) & (in_camera[:, 2] > MIN_DEPTH_M) & straight


def informations(known: Knowledge, base_from_flange: Array) -> list[Array | None]:
    """(p, p) information of a view from each of (n, 4, 4) flange poses; None where it shows too little of the board."""
    found: list[Array | None] = []
    for first in range(0, len(base_from_flange), BLOCK):
        found += _block(known, base_from_flange[first : first + BLOCK])
    return found


def _block(known: Knowledge, base_from_flange: Array) -> list[Array | None]:
    points, views = known.board.points, len(base_from_flange)
    state = replace(known.state, corrections=np.zeros((views, 6)))
    view, every = np.repeat(np.arange(views), len(points)), np.tile(points, (views, 1))
    form = projection.form(known.camera)
    session = Measurements(
        base_from_flange, view, np.zeros((len(view), 2)), every, known.free, form=form, eye_to_hand=known.eye_to_hand
    )
    in_camera = model.camera_points(session, state)
    before = in_camera[:, 2].reshape(views, -1).min(axis=1) > MIN_DEPTH_M
    if not before.any():
        return [None] * views
    numbers = np.cumsum(before) - 1
    chosen = before[view]
    part = replace(session.some(chosen), base_from_flange=base_from_flange[before], view=numbers[view[chosen]])
    pixels, by_global, own = model.predict(part, replace(state, corrections=np.zeros((int(before.sum()), 6))))
    inside = visible(in_camera[chosen], pixels, known.camera).reshape(-1, len(points))
    enough = inside.sum(axis=1) >= _needed(known.board)
    totals = _eliminated(by_global, own, inside, known.sigmas)
    return [totals[numbers[i]] if before[i] and enough[numbers[i]] else None for i in range(views)]


def _needed(board: Board) -> float:
    """Corners of a board that a view must show."""
    if board.is_seen_whole:
        return len(board.points)
    return max(1 if board.has_tags else MIN_CORNERS, MIN_SHARE * len(board.points))


def _eliminated(by_global: Array, own: Array, inside: Mask, sigmas: Sigmas) -> Array:
    """(views, p, p) informations from the derivatives of (views * n) corners, of which those `inside` (views, n) count."""
    weight = (inside / sigmas.pixel)[..., None, None]
    j, k = (
        np.reshape(part.reshape(*inside.shape, 2, -1) * weight, (len(inside), -1, part.shape[-1])) for part in (by_global, own)
    )
    turned = np.swapaxes(j, 1, 2)
    across = turned @ k
    correction = np.swapaxes(k, 1, 2) @ k + np.diag(sigmas.correction**-2.0)
    found = turned @ j - across @ np.linalg.solve(correction, np.swapaxes(across, 1, 2))
    return np.asarray((found + np.swapaxes(found, 1, 2)) / 2, np.float64)


def pose_covariance(information: Array) -> Array:
    """(6, 6) covariance of the hand-eye pose out of the (p, p) information."""
    return covariance_of(information)[-12:-6, -12:-6]


def figures(information: Array, state: State) -> Figures:
    """Limits below which both errors of the hand-eye pose lie with `CERTAINTY`: translation [mm] and rotation [deg].

    The translation is that of the camera's centre in the frame that carries the camera.
    """
    return limits(at_the_pose(pose_covariance(information), state))


def at_the_pose(covariance: Array, state: State) -> Array:
    """(6, 6) covariance with the translation of the camera's centre, out of that of a perturbation from the left.

    A turn about the frame's origin moves the camera's centre c as well: moved = t + w x c.
    """
    change = np.eye(6)
    change[:3, 3:] = -pose.cross(state.mount_from_camera[:3, 3])
    return np.asarray(change @ covariance @ change.T, np.float64)


def limits(covariance: Array) -> Figures:
    """Translation [mm] and rotation [deg] below which a Gaussian error of (6, 6) covariance stays with `CERTAINTY`."""
    return 1e3 * _radius(covariance[:3, :3]), float(np.rad2deg(_radius(covariance[3:, 3:])))


def _radius(covariance: Array) -> float:
    """Length below which a Gaussian vector stays with probability `_EACH`.

    Its square is a weighted sum of chi-squares, replaced by a multiple of one with the same mean and variance
    (Satterthwaite 1946).
    """
    mean, square = float(np.trace(covariance)), float(np.sum(covariance * covariance))
    return float(np.sqrt(square / mean * chdtri(mean**2 / square, 1 - _EACH)))
