"""Which scenes there are to render: an object, its lamps, where these stand, and where the cameras do.

The five of `shiny` stand in a room among cameras all around. For two of them there is also `NAME_room`, `NAME_turntable`,
`NAME_ring_light` and `NAME_side_light`: the same object from cameras on rings, in the same room, turning among lamps and camera
that stand still, and in a dark room under lamps that ride on the camera, in a ring around the lens or beside it. The five of
`near` stand under near lamps, and shade and mirror each other. All are frozen.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.reconstruct.rendered.lamps import Ring
from koala3d.reconstruct.rendered.near.scenes import NEAR, NearScene
from koala3d.reconstruct.rendered.near.views import Lit
from koala3d.reconstruct.rendered.shiny import RADIUS_M, SCENES
from koala3d.reconstruct.rendered.tracer import Tracer
from koala3d.reconstruct.rendered.views import DISTANCE_M, Traced, Views

TRAINED_DEG, TESTED_DEG = (5.0, 30.0, 55.0), (18.0, 42.0)
"""Heights of the rings of cameras above the horizon."""
OBJECTS = ("teapot", "gold_rings")
Pose = NDArray[np.float64]
Shot = tuple[Pose, str]
"""(4, 4) world_from_camera, and the split of its view."""


def fixed(world_from_camera: Pose) -> Pose | None:
    """Lamps that stand still with the object."""
    return None


def turning(world_from_camera: Pose) -> Pose:
    """Lamps that stand still where the object turns about z before the camera: its azimuth in their room is always zero."""
    x, y = world_from_camera[:2, 3] / np.linalg.norm(world_from_camera[:2, 3])
    return np.array([[x, y, 0, 0], [-y, x, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1]])


def carried(world_from_camera: Pose) -> Pose:
    """Lamps that ride on the camera."""
    return pose.inverse(world_from_camera)


def spiral(train: int, test: int, seed: int) -> list[Shot]:
    """Cameras all around, from 25 degrees below the horizon to 75 above; every so many of them is a test view."""
    tested = set(np.linspace(0, train + test - 1, test).round().astype(int).tolist()) if test else set()
    return [(each, "test" if i in tested else "train") for i, each in enumerate(spiral_poses(train + test, seed))]


def spiral_poses(count: int, seed: int) -> list[Pose]:
    """Poses of `count` cameras on a spiral, with random offsets."""
    rng = np.random.default_rng(seed)
    low, high = np.sin(np.deg2rad([-25, 75]))
    found = []
    for index in range(count):
        height = low + (high - low) * (index + rng.random()) / count
        angle = index * np.pi * (3 - np.sqrt(5)) + 0.3 * rng.random()
        across = np.sqrt(1 - height**2)
        found.append(pose.look_at(DISTANCE_M * np.array([across * np.cos(angle), across * np.sin(angle), height]), np.zeros(3)))
    return found


def rings(train: int, test: int, seed: int) -> list[Shot]:
    """Cameras at equal angles on rings; test views lie between the rings. Each ring begins at an angle of its own."""
    rng = np.random.default_rng(seed)
    shots: list[Shot] = []
    for split, heights, total in (("train", TRAINED_DEG, train), ("test", TESTED_DEG, test)):
        for part, height in zip(np.array_split(np.arange(total), len(heights)), np.deg2rad(heights), strict=True):
            for angle in 2 * np.pi * (rng.random() + np.arange(len(part)) / max(len(part), 1)):
                outward = np.array([np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)])
                shots.append((pose.look_at(DISTANCE_M * outward, np.zeros(3)), split))
    return shots


@dataclass(frozen=True)
class Stage:
    """A scene to be rendered."""

    tracer: Callable[[], Tracer]
    shots: Callable[[int, int, int], list[Shot]] = spiral
    """Cameras for so many training and test views and a seed."""
    stand: Callable[[Pose], Pose | None] = fixed
    """(4, 4) lamps_from_world of a view, metres; None where lamps stand still with the object."""
    views: Callable[[Tracer], Views] = Traced
    """What the cameras see of it."""

    def lamps_from_scene(self, world_from_camera: Pose) -> Pose | None:
        """`stand` in the tracer's unit."""
        found = self.stand(world_from_camera)
        return None if found is None else pose.rigid(found[:3, :3], found[:3, 3] / RADIUS_M)


def _under(lamps: Callable[[], Ring], made: Callable[[], Tracer]) -> Callable[[], Tracer]:
    return lambda: replace(made(), light=lamps())


def _near(scene: NearScene) -> Stage:
    return Stage(scene.shape, views=lambda tracer: Lit(scene, tracer))


STAGES: dict[str, Stage] = {name: Stage(made) for name, made in SCENES.items()}
STAGES |= {name: _near(made()) for name, made in NEAR.items()}
for _name in OBJECTS:
    STAGES[f"{_name}_room"] = Stage(SCENES[_name], rings)
    STAGES[f"{_name}_turntable"] = Stage(SCENES[_name], rings, turning)
    STAGES[f"{_name}_ring_light"] = Stage(_under(Ring.about_lens, SCENES[_name]), rings, carried)
    STAGES[f"{_name}_side_light"] = Stage(_under(Ring.beside_lens, SCENES[_name]), rings, carried)
BENCHMARK = (*SCENES, *NEAR)
"""The scenes that a benchmark renders: five that are easy, under distant light, and five that are not."""
