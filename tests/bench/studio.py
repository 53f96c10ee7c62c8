"""A simulated studio of textured ellipsoids on a table, whose geometry and light are known exactly.

Rays meet the solids in closed form; texture is noise in space, so that every view shows the same. Light is an ambient part and
two distant lamps, with matte reflection and a glossy highlight (Phong 1975). The lamps stand still in one of three frames: the
world's, the camera's, or that of a turntable about z.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

Vectors = NDArray[np.float64]

SOLIDS = (((-0.25, 0.1, 0.3), (0.35, 0.4, 0.3)), ((0.35, -0.1, 0.4), (0.25, 0.25, 0.4)), ((0.0, -0.45, 0.15), (0.2, 0.15, 0.15)))
"""Centre and half axes of each ellipsoid [m]; they stand on the table at z = 0."""
BOX = np.array([[-0.65, -0.65, 0.0], [0.65, 0.65, 0.85]])
LAMPS = ((0.6, -0.5, 0.62), (-0.8, -0.3, 0.5))
"""Directions to the lamps, in the lamps' frame of the first camera (x right, y up, z backwards) or in the world."""


@dataclass(frozen=True)
class Studio:
    """What is simulated."""

    views: int = 36
    width: int = 200
    height: int = 150
    lamps: str = "world"
    """Frame in which the lamps stand still: world, camera or turntable."""
    directed: float = 0.6
    """Share of the light that comes from the lamps, 0..1; the rest is ambient."""
    gloss: float = 0.15
    """Strength of the highlights."""
    table: bool = True
    """False: the solids float before nothing, and pictures have an alpha."""
    noise: float = 0.004
    """Standard deviation of the noise, in sRGB."""
    seed: int = 0


def write(studio: Studio, folder: Path) -> Scene:
    """Render the views into `folder` and return their scene; every sixth is a test view."""
    random = np.random.default_rng(studio.seed)
    lattice = random.random((3, 48, 48, 48, 3))
    focal = 1.25 * studio.width
    camera = Camera(studio.width, studio.height, focal, focal, studio.width / 2 + 1.5, studio.height / 2 - 1.0)
    views = []
    for index, world_from_camera in enumerate(places(studio.views)):
        picture = render(studio, camera, world_from_camera, lattice)
        picture[..., :3] += random.normal(0, studio.noise, picture[..., :3].shape)
        path = folder / f"{index:03d}.png"
        images.write(path, picture.clip(0, 1))
        views.append(View(f"{index:03d}", camera, world_from_camera, "train" if index % 6 else "test", path))
    background = "scene" if studio.table else "white"
    near, far = bounds.depth_range(views, BOX)
    return Scene("studio", tuple(views), 0.5 * near, np.inf if studio.table else far, BOX, background, metric=True)


def places(count: int) -> list[Vectors]:
    """Poses on two rings around the solids."""
    found = []
    for index in range(count):
        ring, around = index % 2, 2 * np.pi * index / count
        height, radius = ((0.75, 2.0), (1.35, 1.7))[ring]
        found.append(pose.look_at((radius * np.cos(around), radius * np.sin(around), height), (0, 0, 0.25)))
    return found


def render(studio: Studio, camera: Camera, world_from_camera: Vectors, lattice: NDArray[np.float64]) -> NDArray[np.float64]:
    """(height, width, 3 or 4) sRGB of one view, averaged over four rays a pixel."""
    double = camera.scaled(2 * camera.width, 2 * camera.height)
    rays = double.directions(double.pixel_centres()).reshape(-1, 3) @ world_from_camera[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance, normal = hits(world_from_camera[:3, 3], rays, table=studio.table)
    hit = np.isfinite(distance)
    light = np.zeros((len(rays), 4 if not studio.table else 3))
    points = world_from_camera[:3, 3] + rays[hit] * distance[hit, None]
    light[hit, :3] = shaded(studio, points, normal[hit], rays[hit], lamps(studio.lamps, world_from_camera), lattice)
    if not studio.table:
        light[hit, 3] = 1
    else:
        light[~hit] = 0.25 * texture(3 * rays[~hit] + 7, lattice)
    light = light.reshape(camera.height, 2, camera.width, 2, -1).mean((1, 3))
    if not studio.table:
        light[..., :3] /= np.maximum(light[..., 3:], 1e-6)
    return np.asarray(np.concatenate([images.srgb_from_linear(light[..., :3]), light[..., 3:]], axis=-1), np.float64)


def hits(origin: Vectors, rays: Vectors, *, table: bool) -> tuple[NDArray[np.float64], Vectors]:
    """Distance along (n, 3) unit rays from (3,) `origin`, infinite for none, and the (n, 3) outward normal there."""
    distance, normal = np.full(len(rays), np.inf), np.zeros_like(rays)
    if table:
        down = rays[:, 2] < -1e-9
        t = np.where(down, -origin[2] / np.where(down, rays[:, 2], -1.0), np.inf)
        on = down & (np.linalg.norm(origin[:2] + t[:, None].clip(0, 1e6) * rays[:, :2], axis=1) < 3.0)
        distance[on], normal[on] = t[on], (0, 0, 1)
    for centre, half in SOLIDS:
        start, along = (origin - centre) / np.asarray(half), rays / np.asarray(half)
        a, b, c = (along * along).sum(1), along @ start, float(start @ start) - 1
        root = b * b - a * c
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        nearer = (root > 0) & (t > 0) & (t < distance)
        outward = (start + t[nearer, None] * along[nearer]) / np.asarray(half)
        distance[nearer], normal[nearer] = t[nearer], outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return distance, normal


def lamps(frame: str, world_from_camera: Vectors) -> Vectors:
    """(lamps, 3) unit directions to the lamps in the world, as one view is taken."""
    directions = np.asarray(LAMPS) / np.linalg.norm(LAMPS, axis=1, keepdims=True)
    if frame == "world":
        return directions * [1, -1, 1]
    if frame == "camera":
        return directions @ (world_from_camera[:3, :3] * [1, -1, -1]).T
    x, y = world_from_camera[:2, 3] / np.linalg.norm(world_from_camera[:2, 3])
    return directions @ np.array([[-y, x, 0], [x, y, 0], [0, 0, 1]])


def shaded(
    studio: Studio, points: Vectors, normal: Vectors, rays: Vectors, directions: Vectors, lattice: NDArray[np.float64]
) -> Vectors:
    """(n, 3) linear light that leaves points towards the camera."""
    mirrored = rays - 2 * (rays * normal).sum(1, keepdims=True) * normal
    matte, glossy = np.full(len(points), 1 - studio.directed), np.zeros(len(points))
    for direction, strength in zip(directions, (1.0, 0.6), strict=True):
        matte += 1.4 * studio.directed * strength * np.maximum(normal @ direction, 0)
        glossy += studio.directed * strength * np.maximum(mirrored @ direction, 0) ** 20
    return 0.55 * texture(points, lattice) * matte[:, None] + studio.gloss * glossy[:, None]


def texture(points: Vectors, lattice: NDArray[np.float64]) -> Vectors:
    """(n, 3) albedo in 0.1..1 at points: three octaves of noise on a periodic lattice."""
    from scipy.ndimage import map_coordinates

    found = np.zeros((len(points), 3))
    for octave, (cells, strength) in enumerate(((7.0, 0.3), (19.0, 0.35), (43.0, 0.35))):
        where = (points * cells).T
        for channel in range(3):
            found[:, channel] += strength * map_coordinates(lattice[octave, ..., channel], where, order=1, mode="grid-wrap")
    return np.clip(0.1 + 1.6 * (found - 0.2), 0.05, 1.0)
