"""COLMAP models: made of cameras and poses with pycolmap, and written by its own writer beside Pillow's photographs."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from koala3d.datasets import pose
from tests.foreign import photographs

if TYPE_CHECKING:
    import pycolmap

POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
"""Points of every model; all its images see them."""


def ring(count: int) -> list[NDArray[np.float64]]:
    """(4, 4) world_from_camera around the origin, at different heights."""
    angles = 2 * np.pi * np.arange(count) / count
    return [pose.look_at((np.cos(a), np.sin(a), 0.3 + 0.1 * np.sin(3 * a)), (0, 0, 0)) for a in angles]


def model(
    lenses: Mapping[str, Sequence[float]], poses: Iterable[NDArray[np.float64]], size: tuple[int, int] = (120, 80)
) -> "pycolmap.Reconstruction":
    """A model with one camera for each lens, by COLMAP's name and parameters; they take turns with the world_from_camera."""
    library = pytest.importorskip("pycolmap", reason="pycolmap is absent: it has no wheel for this platform")
    made = library.Reconstruction()
    for number, (lens, parameters) in enumerate(lenses.items(), 1):
        camera = library.Camera(camera_id=number, model=lens, width=size[0], height=size[1], params=parameters)
        made.add_camera_with_trivial_rig(camera)
    for number, world_from_camera in enumerate(poses, 1):
        camera = made.camera(1 + (number - 1) % len(lenses))
        camera_from_world = library.Rigid3d(world_from_camera[:3]).inverse()
        pixels = camera.img_from_cam(camera_from_world * POINTS)
        image = library.Image(f"IMG_{number:04d}.JPG", pixels, camera.camera_id, number)
        made.add_image_with_trivial_frame(image, camera_from_world)
    for row, point in enumerate(POINTS):
        track = library.Track([library.TrackElement(number, row) for number in made.images])
        made.add_point3D(point, track, np.array([row, 100, 200], np.uint8))
    return made


def write(made: "pycolmap.Reconstruction", folder: Path, *, text: bool = False) -> None:
    """The model in `sparse/0`, and in `images` a photograph for each image."""
    (folder / "sparse" / "0").mkdir(parents=True)
    (made.write_text if text else made.write_binary)(folder / "sparse" / "0")
    for number, image in made.images.items():
        picture = np.roll(photographs.corners(image.camera.width, image.camera.height), 5 * number, axis=1)
        photographs.write(folder / "images" / image.name, picture, Make="Koala", Model="One", FocalLengthIn35mmFilm=26)
