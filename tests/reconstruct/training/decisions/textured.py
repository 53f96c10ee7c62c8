"""A wall whose texture is printed on it, or is what it mirrors."""

from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View

CAMERA = Camera(160, 120, 170.0, 170.0, 80.0, 60.0)


def textured_wall(folder: Path, *, mirrored: float = 0.0, gains: bool = False, alpha: bool = False) -> Scene:
    """Ten pictures of a textured wall that leans, from cameras on an arc, 4 away.

    Args:
        mirrored: how far the texture moves over the wall with the camera, as a share of the camera's way.
        gains: whether each picture has an exposure of its own.
        alpha: whether pictures say that all of it is the object.
    """
    random = np.random.default_rng(0)
    texture = sum(s * gaussian_filter(random.normal(size=(1024, 1024)), s, mode="wrap") for s in (1.5, 4, 10))
    texture = (texture - texture.min()) / np.ptp(texture)
    normal, views = np.array([0.3, 0.2, -1.0]), []
    for index in range(10):
        angle = np.deg2rad(5.0 * (index - 4.5))
        matrix = pose.look_at((4 * np.sin(angle), 0.3 * (index % 3), -4 * np.cos(angle)), (0, 0, 0), up=(0, -1, 0))
        rays = CAMERA.directions(CAMERA.pixel_centres()) @ matrix[:3, :3].T
        points = matrix[:3, 3] - rays * (matrix[:3, 3] @ normal / (rays @ normal))[..., None]
        places = points[..., :2] - mirrored * matrix[:2, 3]
        light = map_coordinates(texture, np.moveaxis(places * 130, -1, 0), order=1, mode="grid-wrap")
        if gains:
            light = images.srgb_from_linear(images.linear_from_srgb(light) * (0.6, 1.0)[index % 2])
        picture = np.repeat(light[..., None], 3, -1)
        if alpha:
            picture = np.concatenate([picture, np.ones_like(light)[..., None]], -1)
        images.write(folder / f"{index}.png", picture)
        views.append(View(f"{index}", CAMERA, matrix, "train", folder / f"{index}.png"))
    return Scene("wall", tuple(views), 0.5, np.inf, np.array([[-1.0] * 3, [1.0] * 3]), "scene")
