"""Pictures through any lens from pictures of a centred pinhole, the one camera that all renderers have."""

import numpy as np
from jaxtyping import Float

from koala3d.datasets.camera_model import Camera

FINER = 2
"""Pixels of the pinhole, and places in a pixel of the lens, along each axis for each pixel of the lens."""


def pinhole_for(camera: Camera) -> Camera:
    """A centred pinhole that sees all that a camera sees: the camera itself, if it is one; else a finer one."""
    if camera.is_centred:
        return camera
    seen = np.abs(camera.directions(camera.scaled(*_finer(camera)).pixel_centres() / FINER)[..., :2]).max((0, 1))
    focal = FINER * max(camera.fx, camera.fy)
    width, height = (2 * int(np.ceil(reach * focal + 1)) for reach in seen)
    return Camera(width, height, focal, focal, width / 2, height / 2)


def through(
    camera: Camera, pinhole: Camera, picture: Float[np.ndarray, "h w channels"]
) -> Float[np.ndarray, "height width channels"]:
    """The picture that a camera takes of what `pinhole_for` it shows, each pixel the mean of some places in it."""
    import cv2

    if pinhole == camera:
        return picture
    places = pinhole.project(camera.directions(camera.scaled(*_finer(camera)).pixel_centres() / FINER)) - 0.5
    columns, rows = np.moveaxis(places.astype(np.float32), -1, 0)
    found = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(camera.height, FINER, camera.width, FINER, -1).mean((1, 3))


def _finer(camera: Camera) -> tuple[int, int]:
    return FINER * camera.width, FINER * camera.height
