"""Made-up scenes of which the geometry is known exactly."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View

CAMERA = Camera(128, 96, 110, 110, 64, 48)
WALLS = Camera(200, 150, 220.0, 221.0, 101.0, 74.0, k1=-0.05)


@pytest.fixture(scope="session")
def camera_ring() -> Callable[..., list[View]]:
    """Factory of cameras on a ring that look at its centre; they have no images."""

    def make(centre: tuple = (1.0, 2.0, 3.0), radius: float = 4.0, count: int = 12) -> list[View]:
        views = []
        for index in range(count):
            angle = 2 * np.pi * index / count
            position = np.add(centre, (radius * np.cos(angle), radius * np.sin(angle), 1.5 * np.sin(3 * angle)))
            views.append(View(str(index), CAMERA, pose.look_at(position, centre), "train", Path("none")))
        return views

    return make


@pytest.fixture(scope="session")
def wall_picture() -> Callable[[Camera, np.ndarray], np.ndarray]:
    """Function that paints the (height, width, 3) picture of `two_walls` from a camera with its (4, 4) world_from_camera."""
    random, textures = np.random.default_rng(0), []
    for _ in range(2):
        texture = sum(s * gaussian_filter(random.normal(size=(1024, 1024)), s, mode="wrap") for s in (1.5, 4, 10))
        textures.append((texture - texture.min()) / np.ptp(texture))

    def picture(camera: Camera, matrix: np.ndarray) -> np.ndarray:
        rays = camera.directions(camera.pixel_centres()) @ matrix[:3, :3].T
        result = np.zeros(rays.shape[:2])
        for texture, depth, half in ((textures[1], 2.0, np.inf), (textures[0], 0.0, 0.8)):
            points = matrix[:3, 3] + rays * ((depth - matrix[2, 3]) / rays[..., 2:])
            values = map_coordinates(texture, np.moveaxis(points[..., :2] * 160, -1, 0), order=1, mode="grid-wrap")
            result = np.where((np.abs(points[..., :2]) < half).all(-1), values, result)
        return np.repeat(result[..., None], 3, axis=-1)

    return picture


@pytest.fixture(scope="session")
def painted_walls(
    tmp_path_factory: pytest.TempPathFactory, wall_picture: Callable[[Camera, np.ndarray], np.ndarray]
) -> Callable[[Camera], Scene]:
    """Factory of the scenes of `two_walls`, painted once for each camera: nobody may change these pictures."""

    @cache
    def paint(camera: Camera) -> Scene:
        folder, views = tmp_path_factory.mktemp("walls"), []
        for index in range(12):
            angle = np.deg2rad(4.0 * (index - 5.5))
            position = (4 * np.sin(angle), 0.25 * (index % 3), -4 * np.cos(angle))
            matrix = pose.look_at(position, (0, 0, 0), up=(0, -1, 0))
            path = folder / f"{index:02d}.png"
            images.write(path, wall_picture(camera, matrix))
            views.append(View(f"{index:02d}", camera, matrix, "train", path))
        box = np.array([[-9.0, -9, -9], [9, 9, 9]])
        return Scene("walls", tuple(views), 0.01, np.inf, box, "scene", bounds_from="cameras alone")

    return paint


@pytest.fixture
def two_walls(painted_walls: Callable[[Camera], Scene], tmp_path: Path) -> Callable[..., Scene]:
    """Factory of pictures of a textured square of side 1.6 at z = 0 before a textured wall at z = 2, from 4 away.

    Twelve cameras on an arc look at the origin along +z, with the lens that is given. A test may change the pictures.
    """

    def make(camera: Camera = WALLS) -> Scene:
        scene, folder = painted_walls(camera), tmp_path / "walls"
        shutil.copytree(scene.views[0].image.parent, folder)
        return scene.with_views(tuple(replace(view, image=folder / view.image.name) for view in scene.views))

    return make
