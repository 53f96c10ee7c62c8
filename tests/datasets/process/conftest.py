"""A made-up table with boxes, rendered by ray casting: photographs whose poses are known exactly."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.process.world.similarity import Similarity
from koala3d.datasets.scene import Scene, View
from tests.foreign import photographs

Array = NDArray[np.float64]

CAMERA = Camera(400, 300, 420.0, 421.0, 203.0, 147.0, k1=-0.04)
MARKER_SIDE = 0.24
"""Side of the printed marker on the table [m]."""
BOXES = (((-0.5, -0.45, 0.0), (-0.2, -0.15, 0.25)), ((0.2, -0.4, 0.0), (0.45, -0.1, 0.35)), ((-0.5, 0.2, 0.0), (-0.3, 0.4, 0.15)))
"""Lower and upper corner [m]; they stand on the table, which is z = 0."""
TEXELS = 400
"""Texture pixels per metre."""


@dataclass(frozen=True)
class Table:
    """The textures of the table and the boxes, and whether a marker lies beside them."""

    textures: tuple[Array, ...]
    marker: Array | None

    def colour(self, which: int, plane: Array) -> Array:
        """(n,) grey in 0..1 of surface `which` at (n, 2) positions in its plane [m]."""
        values = map_coordinates(self.textures[which], np.moveaxis(plane * TEXELS, -1, 0), order=1, mode="grid-wrap")
        if which == 0 and self.marker is not None:
            half = MARKER_SIDE / 2 * self.marker.shape[0] / (self.marker.shape[0] - 2 * BORDER)
            place = (plane - MARKER_CENTRE) * [1, -1]  # rows of the print run against y
            inside = (np.abs(place) < half).all(-1)
            cells = ((place[inside] + half) / (2 * half) * self.marker.shape[0]).astype(int).clip(0, self.marker.shape[0] - 1)
            values[inside] = self.marker[cells[:, 1], cells[:, 0]]
        return values

    def photograph(self, camera: Camera, world_from_camera: Array) -> NDArray[np.uint8]:
        """What a camera sees, with four rays per pixel."""
        rays = directions(camera) @ world_from_camera[:3, :3].T
        origin = world_from_camera[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(rays[:, 2] < 0, -origin[2] / rays[:, 2], np.inf)
            entered = [_entered(origin, rays, *map(np.array, box)) for box in BOXES]
        nearest = np.argmin(np.stack([distance, *(far for far, _ in entered)]), axis=0)
        result = np.full(len(rays), 0.5)
        floor = (nearest == 0) & (distance < 8)
        result[floor] = self.colour(0, (origin + rays[floor] * distance[floor, None])[:, :2])
        for number, (far, axis) in enumerate(entered, 1):
            hit = (nearest == number) & np.isfinite(far)
            points = origin + rays[hit] * far[hit, None]
            flat = np.stack(
                [np.where(axis[hit] == 0, points[:, 1], points[:, 0]), np.where(axis[hit] == 2, points[:, 1], points[:, 2])], -1
            )
            result[hit] = self.colour(number, flat + axis[hit, None])
        grey = result.reshape(camera.height, camera.width, 4).mean(-1)
        return np.repeat(np.rint(255 * grey)[..., None], 3, axis=-1).astype(np.uint8)


BORDER = 2
"""White cells around the marker."""
MARKER_CENTRE = np.array([0.1, 0.2])


@cache
def directions(camera: Camera) -> Array:
    """(4 * pixels, 3) rays in the camera's frame."""
    offsets = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
    return camera.directions((camera.pixel_centres()[:, :, None] + offsets).reshape(-1, 2))


def _entered(origin: Array, rays: Array, low: Array, high: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distance at which rays enter a box, infinite where they miss it, and the axis of the face."""
    first, second = (low - origin) / rays, (high - origin) / rays
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    near = enter.max(1)
    return np.where((near < leave.min(1)) & (near > 0), near, np.inf), enter.argmax(1)


def make_table(*, marker: bool, seed: int = 0) -> Table:
    """A table with random textures; with `marker`, number 7 of DICT_4X4_50 is printed on it."""
    random = np.random.default_rng(seed)
    textures = []
    for _ in range(1 + len(BOXES)):
        noise = sum(scale * gaussian_filter(random.normal(size=(1024, 1024)), scale, mode="wrap") for scale in (2, 5, 14))
        textures.append(0.5 + 0.22 * noise / np.std(noise))
    printed = None
    if marker:
        cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, 6)
        printed = np.pad(cells / 255.0, BORDER, constant_values=1.0)
    return Table(tuple(np.clip(texture, 0, 1) for texture in textures), printed)


def ring(count: int, *, radius: float = 1.6, height: float = 1.0, sweep_deg: float = 150.0, wave: float = 0.2) -> list[Array]:
    """Poses on an arc around the table's middle, at heights that change by up to `wave`."""
    angles = np.deg2rad(np.linspace(0, sweep_deg, count))
    heights = height + wave * np.sin(3 * np.arange(count))
    places = [(radius * np.cos(a), radius * np.sin(a), h) for a, h in zip(angles, heights, strict=True)]
    return [pose.look_at(place, (0.0, 0.0, 0.1)) for place in places]


@dataclass(frozen=True)
class Shots:
    """A folder of photographs and where they were taken."""

    folder: Path
    poses: dict[str, Array]
    """world_from_camera by name."""


@pytest.fixture(scope="session")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Shots:
    """Ten photographs of a table with a marker, their names in another order than their places, and of three formats.

    The JPEGs are stored turned, with EXIF's orientation, as cameras store what they take on their side or upside down.
    """
    folder, table = tmp_path_factory.mktemp("photos"), make_table(marker=True)
    poses = {}
    for index, matrix in enumerate(ring(10)):
        name = f"my photo {index * 7 % 10}"
        suffix = (".png", ".JPG", ".tiff")[index % 3]
        orientation = {1: 6, 4: 3, 7: 8}.get(index, 1)
        photographs.write(folder / f"{name}{suffix}", table.photograph(CAMERA, matrix), orientation=orientation)
        poses[name] = matrix
    return Shots(folder, poses)


@pytest.fixture(scope="session")
def photograph_of() -> Callable[[Array, int], NDArray[np.uint8]]:
    """Factory of photographs of a table without a marker, from a pose, with textures by a seed."""
    tables: dict[int, Table] = {}

    def make(matrix: Array, seed: int = 0) -> NDArray[np.uint8]:
        if seed not in tables:
            tables[seed] = make_table(marker=False, seed=seed)
        return tables[seed].photograph(CAMERA, matrix)

    return make


@pytest.fixture
def tilted(shots: Shots) -> Scene:
    """The photographs with their true poses, in half the size and lying on the side."""
    away = Similarity(0.5, pose.from_rotation_vector([1.0, 0.5, 0.2])[:3, :3], np.array([1.0, 2.0, 3.0]))
    files = {path.stem: path for path in shots.folder.iterdir()}
    views = [away.view(View(name, CAMERA, matrix, "train", files[name])) for name, matrix in shots.poses.items()]
    box = np.array([[0.0, 1.0, 2.0], [2.0, 3.0, 4.0]])
    return Scene("tilted", tuple(views), 0.1, np.inf, box, "scene", bounds_from="cameras alone")


@pytest.fixture(scope="session")
def ring_of() -> Callable[..., list[Array]]:
    """`ring`."""
    return ring
