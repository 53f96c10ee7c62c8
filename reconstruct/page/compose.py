"""Pictures for the page of a run: each channel from a browser's viewpoint, and a photograph warped to it."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.output.export import brightness_of_depth
from koala3d.reconstruct.scene.rays import over

Values = dict[str, NDArray[np.float32]]

NORMALS = "normals"  # the channel that requires a second pass through the field
SHADED = ("rgb", "diffuse", "specular", NORMALS)
CHANNELS = (
    {name: name for name in SHADED} | {"normals (predicted)": "normals_pred"} | {n: n for n in ("depth", "opacity", "roughness")}
)
"""Names on the page, and the renderer's names."""
COVERING = 0.5  # opacity above which a pixel hides what is behind it
BEHIND_ALL = 160.0  # depth of pixels that hide nothing: the page's depth ends at 167


@dataclass(frozen=True)
class Viewpoint:
    """The camera of a browser."""

    world_from_camera: NDArray[np.float64]  # (4, 4), OpenCV camera axes
    fov: float  # vertical field of view [rad]
    aspect: float  # width by height

    def camera(self, rays: int) -> Camera:
        """A pinhole camera with about `rays` pixels."""
        width = max(2, round(float(np.sqrt(rays * self.aspect))))
        height = max(2, rays // width)
        focal = 0.5 * height / np.tan(0.5 * self.fov)
        return Camera(width, height, focal, focal * 1.0, width / 2, height / 2)

    def view(self, camera: Camera) -> View:
        """The viewpoint as a view of a scene, for the renderer."""
        return View("browser", camera, self.world_from_camera, "test", Path())


def picture_of(channel: str, values: Values) -> NDArray[np.float32]:
    """(height, width, 3) sRGB in 0..1 of one of `CHANNELS`.

    Args:
        channel: a key of `CHANNELS`.
        values: (height, width, channels) by the renderer's names; light is linear and premultiplied, except "rgb".
    """
    name = CHANNELS[channel]
    shown = values[name]
    if name in ("diffuse", "specular"):
        shown = images.srgb_from_linear(np.maximum(shown, 0))
    elif name in ("normals", "normals_pred"):
        length = np.linalg.norm(shown, axis=-1, keepdims=True)
        shown = 0.5 + 0.5 * shown / np.maximum(length, 1e-6) * (length > 1e-3)
    elif name == "depth":
        shown = brightness_of_depth(shown * (values["opacity"] > 0.05))
    elif name == "roughness":
        shown = shown / np.maximum(values["opacity"], 1e-3) * (values["opacity"] > 0.05)
    return np.clip(np.broadcast_to(shown, (*shown.shape[:2], 3)), 0, 1).astype(np.float32)


def hiding_depth(values: Values) -> NDArray[np.float32]:
    """(height, width) depth along z [world unit] that hides objects behind it; far where the pixel is transparent."""
    depth = values["depth"][..., 0]
    return np.where((values["opacity"][..., 0] > COVERING) & (depth > 0), depth, BEHIND_ALL).astype(np.float32)


def nearest_view(viewpoint: Viewpoint, views: tuple[View, ...], reach: float) -> View:
    """The view nearest to a viewpoint: a distance of `reach` [world unit] counts as much as a radian."""
    matrices = np.stack([view.world_from_camera for view in views])
    distance, _ = pose.difference(matrices, viewpoint.world_from_camera[None])
    turn = np.arccos(np.clip(matrices[:, :3, 2] @ viewpoint.world_from_camera[:3, 2], -1, 1))
    return views[int(np.argmin(distance / reach + turn))]


def warped(viewpoint: Viewpoint, camera: Camera, view: View, photograph: NDArray[np.float32]) -> NDArray[np.float32]:
    """A photograph rotated to a viewpoint: (height, width, 3) of `camera`; grey outside the photograph.

    Exact for distant objects, or at the photograph's own position; parallax is ignored.

    Args:
        viewpoint: position and direction of the result.
        camera: pinhole camera of the result.
        view: of the photograph, with its lens.
        photograph: (height, width, 3 or 4) sRGB.
    """
    turn = view.world_from_camera[:3, :3].T @ viewpoint.world_from_camera[:3, :3]
    directions = camera.directions(camera.pixel_centres()) @ turn.T
    ahead = directions[..., 2] > 1e-3
    pixels = view.camera.project(np.where(ahead[..., None], directions, [0.0, 0.0, 1.0]))
    scale = photograph.shape[1] / view.camera.width
    inside = ahead & (pixels >= 0).all(-1) & (pixels <= [view.camera.width, view.camera.height]).all(-1)
    places = (scale * pixels - 0.5).astype(np.float32)
    flat = np.ascontiguousarray(over(photograph), np.float32)
    sampled = cv2.remap(flat, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.where(inside[..., None], sampled, 0.5).astype(np.float32)


def wiped(left: NDArray[np.float32], right: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """The left `share` of one picture and the rest of another of the same size, separated by a white line."""
    edge = round(share * left.shape[1])
    joined = np.concatenate([left[:, :edge], right[:, edge:]], axis=1)
    joined[:, max(edge - 1, 0) : edge + 1] = 1.0
    return joined


def enlarged(picture: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    """A picture enlarged to at least `width` pixels, by linear interpolation."""
    if picture.shape[1] >= width:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
