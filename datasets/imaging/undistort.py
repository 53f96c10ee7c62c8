"""From a real lens to a centred pinhole, for formats without a lens model.

The new camera has the old one's position and focal length. Its axis is turned to the middle of the old image, so that an
off-centre lens loses no part of it, and its image is cut so that every pixel was seen by the old camera.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import conventions, pose
from koala3d.datasets.camera_model import Camera

COLOUR, QUICK, SMOOTH, NEAREST = "colour", "quick", "smooth", "nearest"
"""Interpolation. COLOUR: Lanczos' over 8x8 pixels, which keeps detail and noise. QUICK: cubic over 4x4, a third of the time, for
pictures whose compression loses more than that does. SMOOTH: linear, never overshoots. NEAREST: for values that must not be
mixed. OpenCV rounds positions to a 32nd of a pixel."""
ROWS = 256
"""Rows of the new picture that are made at a time: positions in double precision would take eight times its memory."""


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A centred pinhole whose image `source` covers."""

    source: Camera
    camera: Camera
    source_from_camera: NDArray[np.float64]
    """(4, 4) rotation from the new camera's frame to the old one's."""

    @property
    def turned_deg(self) -> float:
        """Angle between the two axes [deg]."""
        return float(np.rad2deg(pose.rotation_angle(self.source_from_camera)))

    def source_pixels(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """(..., 2) pixels of the new image to (..., 2) pixels of the old one."""
        return self.source.project(self.camera.directions(pixels) @ self.source_from_camera[:3, :3].T)

    def depth_factor(self) -> NDArray[np.float32]:
        """(height, width, 1) factor from depth along the old z to depth along the new z."""
        directions = self.camera.directions(self.camera.pixel_centres()) @ self.source_from_camera[:3, :3].T
        return (1 / directions[..., 2:]).astype(np.float32)

    def resample(self, picture: NDArray[Any], how: str = COLOUR) -> NDArray[Any]:
        """(height, width, channels) of the new camera from the old one's image, of its type: uint8, uint16 or float32.

        With COLOUR and QUICK, the second or fourth channel is a straight alpha, which weights the colours; floats are clipped to
        0..1.
        """
        has_alpha = how in (COLOUR, QUICK) and picture.shape[-1] in (2, 4)
        result = np.empty((self.camera.height, self.camera.width, picture.shape[-1]), picture.dtype)
        places = _places(self)
        if picture.dtype == np.uint8 and how != COLOUR and not has_alpha:  # rounded and clipped by OpenCV
            for start in range(0, len(result), ROWS):
                result[start : start + ROWS] = _remapped(picture, places[start : start + ROWS], how)
            return result
        top = 1.0 if picture.dtype == np.float32 else float(np.iinfo(picture.dtype).max)
        values = np.asarray(picture, np.float32)
        if has_alpha:
            values = np.concatenate([values[..., :-1] * (values[..., -1:] / np.float32(top)), values[..., -1:]], axis=-1)
        for start in range(0, len(result), ROWS):
            rows = _remapped(values, places[start : start + ROWS], how)
            if has_alpha:  # both overshoot alike at an edge, so divide before clipping
                alpha = rows[..., -1:] / np.float32(top)
                rows = np.concatenate([rows[..., :-1] / np.where(alpha > 1e-3, alpha, 1.0), rows[..., -1:]], axis=-1)
            if how in (COLOUR, QUICK):
                np.clip(rows, 0, top, out=rows)
            result[start : start + ROWS] = rows if picture.dtype == np.float32 else np.rint(rows, out=rows)
        return result


@lru_cache(maxsize=1)
def _places(pinhole: Pinhole) -> NDArray[np.float32]:
    """(height, width, 2) positions of the new pixel centres in the old image, in OpenCV's coordinates."""
    camera = pinhole.camera
    places = np.empty((camera.height, camera.width, 2), np.float32)
    columns = np.arange(camera.width) + 0.5
    for start in range(0, camera.height, ROWS):
        rows = np.arange(start, min(start + ROWS, camera.height)) + 0.5
        centres = np.stack(np.broadcast_arrays(columns, rows[:, None]), axis=-1)
        places[start : start + ROWS] = conventions.opencv_from_pixels(pinhole.source_pixels(centres))
    return places


def _remapped(values: NDArray[Any], places: NDArray[np.float32], how: str) -> NDArray[Any]:
    import cv2

    flags = {COLOUR: cv2.INTER_LANCZOS4, QUICK: cv2.INTER_CUBIC, SMOOTH: cv2.INTER_LINEAR, NEAREST: cv2.INTER_NEAREST}
    found = cv2.remap(values, places, None, flags[how], borderMode=cv2.BORDER_REFLECT_101)  # type: ignore[call-overload]
    return np.asarray(found).reshape(*places.shape[:2], values.shape[-1])


@lru_cache(maxsize=8)
def pinhole(source: Camera) -> Pinhole:
    """The largest centred pinhole with the aspect ratio of `source` whose image `source` covers.

    Raises:
        ValueError: the lens distorts so strongly that no image is left.
    """
    axis = source.directions([source.width / 2, source.height / 2])
    source_from_camera = np.eye(4) if source.is_centred else _turn(axis / np.linalg.norm(axis))
    if source.is_centred:
        return Pinhole(source, source, source_from_camera)
    focal = float(np.sqrt(source.fx * source.fy))

    def sized(scale: float) -> Pinhole:
        width, height = max(int(source.width * scale), 1), max(int(source.height * scale), 1)
        return Pinhole(source, Camera(width, height, focal, focal, width / 2, height / 2), source_from_camera)

    low, high = 0.0, 2.0
    while high - low > 0.5 / max(source.width, source.height):
        middle = (low + high) / 2
        low, high = (middle, high) if _is_seen(sized(middle)) else (low, middle)
    found = sized(low)
    if min(found.camera.width, found.camera.height) < 2:
        raise ValueError("the lens leaves no image")
    return found


def _turn(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) smallest rotation that takes the z axis to a unit vector."""
    across = np.cross([0.0, 0.0, 1.0], axis)
    sine = np.linalg.norm(across)
    angle = np.arctan2(sine, axis[2])
    return pose.from_rotation_vector(across * (angle / sine) if sine > 1e-15 else np.zeros(3))


def _is_seen(candidate: Pinhole) -> bool:
    """True where the whole border lies between pixel centres of the source and its distortion is invertible there."""
    camera, source = candidate.camera, candidate.source
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    edges = ((columns, rows[0]), (columns, rows[-1]), (columns[0], rows), (columns[-1], rows))
    border = np.concatenate([np.stack(np.broadcast_arrays(*edge), axis=-1) for edge in edges])
    rays = camera.directions(border) @ candidate.source_from_camera[:3, :3].T
    if (rays[:, 2] <= 0).any():
        return False
    ideal = rays[:, :2] / rays[:, 2:]
    pixels = source.project(rays)
    inside = (pixels >= 0.5).all() and (pixels <= [source.width - 0.5, source.height - 0.5]).all()
    return bool(inside) and bool(np.abs(source.undistort(source.distort(ideal)) - ideal).max() < 1e-6)
