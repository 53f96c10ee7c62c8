"""A first idea of the rig from one to a few views, before a calibration is possible: enough to choose the next view.

The focal length comes from the views at hand, the mount from the drawing, and the board from both. Broad priors take the place
of what these views do not show.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from koala3d.calib.advice.information import Knowledge, informations
from koala3d.calib.arrays import Array
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.handeye.refine import Sigmas
from koala3d.calib.intrinsics import estimate, lenses, projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import conventions
from koala3d.datasets.camera_model import Camera

SIGMA_PX = 0.2  # usual standard deviation of a corner per axis
FOCAL_STD, CENTRE_STD, BENDING_STD, TANGENTIAL_STD = 0.1, 0.03, 0.2, 0.01
"""Prior deviations: of the focal length, relative; of the principal point, as a share of the width; of radial and tangential
coefficients."""
MOUNT_STD_M, MOUNT_STD_RAD = 0.01, float(np.deg2rad(5))  # a bracket as known from a drawing or a ruler
BOARD_STD_M, BOARD_STD_RAD = 1.0, 1.0  # the board may lie anywhere
FOCAL_RANGE = (0.3, 5.0)  # believable focal lengths, as shares of the width
USUAL_FOCAL = 0.8  # share of the width that is taken where the views do not tell


def known(session: TargetSession, mount: Array, accuracy: Accuracy) -> Knowledge:
    """What one or more views say, with priors for the rest.

    Args:
        mount: (4, 4) flange_from_camera as known from a drawing; base_from_camera of a camera beside the arm.
    """
    seen, flown = session.observations, session.base_from_flange
    camera = _camera(seen, (session.width, session.height))
    boards = session.stand_from_mount @ mount @ estimate.camera_from_boards(camera, seen)
    state = State(projection.vector(camera), mount, boards[-1], np.zeros((1, 6)))
    free = lenses.USUAL.free
    sigmas = Sigmas(SIGMA_PX, accuracy.translation_m, accuracy.rotation_rad)
    prior = np.diag(_deviations(camera, free) ** -2.0)
    first = Knowledge(camera, session.board, free, state, sigmas, prior, session.eye_to_hand)
    told = [information for information in informations(first, flown) if information is not None]
    return replace(first, information=prior + np.sum(told, axis=0))


def _camera(seen: Sequence[Observation], size: tuple[int, int]) -> Camera:
    """A camera without distortion: its focal length from the views, where they are tilted enough to show it."""
    width, height = size
    points = [o.points.astype(np.float32) for o in seen]
    pixels = [conventions.opencv_from_pixels(o.pixels).astype(np.float32) for o in seen]
    flags = (
        cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    usual = USUAL_FOCAL * width
    start = np.array([[usual, 0, (width - 1) / 2], [0, usual, (height - 1) / 2], [0, 0, 1.0]])
    try:
        focal = float(cv2.calibrateCamera(points, pixels, size, start, np.zeros(5), flags=flags)[1][0, 0])
    except cv2.error:
        focal = usual
    if not FOCAL_RANGE[0] <= focal / width <= FOCAL_RANGE[1]:
        focal = usual
    return Camera(width, height, focal, focal, width / 2, height / 2)


def _deviations(camera: Camera, free: Sequence[str]) -> Array:
    """(p,) prior standard deviations of the global unknowns."""
    of_name = {"f": FOCAL_STD * camera.fx, "c": CENTRE_STD * camera.width, "k": BENDING_STD, "p": TANGENTIAL_STD}
    poses = np.repeat([MOUNT_STD_M, MOUNT_STD_RAD, BOARD_STD_M, BOARD_STD_RAD], 3)
    return np.concatenate([[of_name[name[0]] for name in free], poses])
