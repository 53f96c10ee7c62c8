"""A painted ball with a highlight: the scene of trainings that have to learn something.

Each model learns a little of it in a few hundred steps. The default model of `SETTINGS` is compiled once for all tests.
"""

from pathlib import Path

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import koala
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View

CAMERA = Camera(56, 56, 84.0, 84.0, 28.0, 28.0)
RADIUS, DISTANCE = 0.08, 0.3
"""Of the ball, and of the cameras from its centre [m]."""
SUN = np.array([0.36, -0.48, 0.8])
TRAIN, TEST = 36, 6
SETTINGS = ("encoding.log2_size=13", "sampler.rays=1000", "sampler.samples=6000", "sampler.grid=32")
"""Of a training on it: the fast preset with small tables, which no other array is as large as."""


def paint(normal: np.ndarray) -> np.ndarray:
    """Linear diffuse colour where the ball has unit normals (..., 3)."""
    return 0.25 + 0.15 * np.sin(normal @ np.diag([9.0, 11.0, 13.0])) + 0.08 * np.cos(7 * normal[..., ::-1])


def seen(
    camera: Camera, world_from_camera: np.ndarray, world_from_ball: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Linear colour and opacity of each pixel, and the normals: waves of paint, and a highlight of the sun.

    Args:
        world_from_ball: (3, 3) how the ball was turned before the sun; None: not at all.
    """
    directions = camera.directions(camera.pixel_centres()) @ world_from_camera[:3, :3].T
    directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    origin = world_from_camera[:3, 3]
    along, inside = directions @ origin, (directions @ origin) ** 2 - origin @ origin + RADIUS**2
    hit = (inside > 0)[..., None]
    normal = (origin + (-along - np.sqrt(np.maximum(inside, 0)))[..., None] * directions) / RADIUS
    reflected = directions - 2 * np.sum(directions * normal, -1, keepdims=True) * normal
    highlight = 0.8 * np.exp(20 * (reflected @ SUN - 1))[..., None]
    painted = paint(normal if world_from_ball is None else normal @ world_from_ball)
    return np.concatenate([painted + highlight, np.ones_like(highlight)], -1) * hit, normal * hit


def photographed(path: Path, world_from_camera: np.ndarray, world_from_ball: np.ndarray | None = None) -> np.ndarray:
    """Write what a camera sees, with its opacity; returns it (height, width, 4), linear. `world_from_ball`: see `seen`."""
    fine, _ = seen(CAMERA.scaled(4 * CAMERA.width, 4 * CAMERA.height), world_from_camera, world_from_ball)
    linear = fine.reshape(CAMERA.height, 4, CAMERA.width, 4, 4).mean((1, 3))
    colour = images.srgb_from_linear(linear[..., :3] / np.maximum(linear[..., 3:], 1e-6))
    images.write(path, np.concatenate([colour, linear[..., 3:]], -1))
    return linear


def save(root: Path) -> Path:
    """Write it as a Koala scene below `root`; returns its folder. Each seventh view is for testing and has true normals."""
    views = []
    for index in range(TRAIN + TEST):
        up, around = 1 - 2 * (index + 0.5) / (TRAIN + TEST), index * np.pi * (3 - np.sqrt(5))
        flat = np.sqrt(1 - up * up)
        matrix = pose.look_at(DISTANCE * np.array([flat * np.cos(around), flat * np.sin(around), up]), np.zeros(3))
        path = root / "source" / f"{index:03d}.png"
        linear = photographed(path, matrix)
        truth, split = {}, "test" if index % 7 == 3 else "train"
        if split == "test":
            for name, values in {"normals": seen(CAMERA, matrix)[1], "alpha": linear[..., 3:]}.items():
                truth[name] = path.with_name(f"{path.stem}_{name}.exr")
                images.write(truth[name], values.astype(np.float32))
        views.append(View(path.stem, CAMERA, matrix, split, path, None, truth))
    box = np.array([[-0.1] * 3, [0.1] * 3])
    koala.save(Scene("ball", tuple(views), 0.05, np.inf, box, "white", metric=True), root / "ball")
    return root / "ball"
