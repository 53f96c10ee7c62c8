"""From a real lens to a centred pinhole, for formats without a lens model.

The new camera has the old one's position and focal length. Its axis is turned to the middle of the old image, so that an
off-centre lens loses no part of it, and its image is cut so that every pixel was seen by the old camera.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera

COLOUR, SMOOTH, NEAREST = 5, 1, 0
"""Orders of interpolation. COLOUR: quintic spline, nearly as sharp as a sinc, which keeps detail and noise (Thevenaz et al. 2000,
"Interpolation Revisited"). SMOOTH: linear, never overshoots. NEAREST: for values that must not be mixed."""

BORDER = 12
"""Pixels of antisymmetric padding around an image, which keep the spline smooth at the border."""


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

    @cached_property
    def _centres(self) -> NDArray[np.float64]:
        """(height, width, 2) positions of the new pixel centres in the old image."""
        return self.source_pixels(self.camera.pixel_centres())

    def depth_factor(self) -> NDArray[np.float32]:
        """(height, width, 1) factor from depth along the old z to depth along the new z."""
        directions = self.camera.directions(self.camera.pixel_centres()) @ self.source_from_camera[:3, :3].T
        return (1 / directions[..., 2:]).astype(np.float32)

    def resample(self, picture: NDArray[np.float32], order: int = COLOUR) -> NDArray[np.float32]:
        """(height, width, channels) of the new camera from the old one's image; COLOUR clips to 0..1.

        With COLOUR, the second or fourth channel is a straight alpha, which weights the colours.
        """
        from scipy.ndimage import map_coordinates

        columns, rows = np.moveaxis(self._centres - 0.5 + BORDER, -1, 0)
        has_alpha = order == COLOUR and picture.shape[-1] in (2, 4)
        if has_alpha:
            picture = np.concatenate([picture[..., :-1] * picture[..., -1:], picture[..., -1:]], axis=-1)
        wider = np.pad(picture, ((BORDER, BORDER), (BORDER, BORDER), (0, 0)), "reflect", reflect_type="odd")
        channels = [
            map_coordinates(wider[..., k], [rows, columns], np.float32, order, mode="mirror") for k in range(picture.shape[-1])
        ]
        result = np.stack(channels, axis=-1)
        if has_alpha:  # both overshoot alike at an edge, so divide before clipping
            alpha = result[..., -1:]
            result = np.concatenate([result[..., :-1] / np.where(alpha > 1e-3, alpha, 1.0), alpha], axis=-1)
        return (np.clip(result, 0, 1) if order == COLOUR else result).astype(np.float32)


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
