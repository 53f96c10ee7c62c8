"""The simulated laboratory: what stands on the table in front of the robot, as shapes, colours and light.

Everything is in the robot's base frame [m], the table's top at z = 0. A stage knows nothing of a renderer.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from capture.errors import SimulationError
from capture.sim import textures
from datasets.errors import Misuse, nearest

SCENES = {
    "gold_head": "a life-like head of rough gold on a plinth",
    "shiny_ball": "a sphere of polished gold",
    "charuco_board": "the calibration board",
}
TABLE_SIZE = 1.8


@dataclass(frozen=True)
class Matt:
    """A surface that scatters light evenly: one colour (3,), or a texture (h, w, 3), in linear light."""

    reflectance: NDArray[np.float32]


@dataclass(frozen=True)
class Gold:
    """Rough gold."""

    roughness: float
    """Microfacet alpha: 0.05 is polished, 0.3 brushed."""


@dataclass(frozen=True)
class Item:
    """One thing on the stage, its mesh in the base frame [m]."""

    name: str
    mesh: trimesh.Trimesh
    material: Matt | Gold
    uv: NDArray[np.float32] | None = None
    """(vertices, 2) texture coordinates, for a texture."""
    smooth: bool = False
    """True where the mesh carries its own normals."""


@dataclass(frozen=True)
class Stage:
    """All that light can meet: the first item is the object that the capture is about."""

    name: str
    items: tuple[Item, ...]
    room: NDArray[np.float32]
    """(h, 2h, 3) radiance of the surroundings, see `textures.room`."""


def check_name(name: str) -> str:
    """`name` where it is a scene's; else Misuse naming the nearest one."""
    if name not in SCENES:
        raise Misuse(f"unknown scene '{name}'", remedy=nearest(name, SCENES))
    return name


def stage(name: str, *, centre: ArrayLike, size: ArrayLike, seed: int) -> Stage:
    """The stage of a scene, its object in the middle of the object volume's floor.

    Args:
        name: "gold_head" or "shiny_ball".
        centre: (3,) middle of the object volume in the base frame [m].
        size: (3,) its edges [m].
        seed: of the textures.
    """
    rng = np.random.default_rng([seed, 11])
    centre, size = np.asarray(centre, np.float64), np.asarray(size, np.float64)
    thing = Item(name, _object_mesh(name, centre, size), Gold(0.12 if name == "gold_head" else 0.06), smooth=True)
    return Stage(name, (thing, _table(centre, rng), *_props(centre, size, rng)), textures.room(rng))


def _object_mesh(name: str, centre: NDArray[np.float64], size: NDArray[np.float64]) -> trimesh.Trimesh:
    """Mesh in the base frame, standing in the middle of the volume's floor; made smaller where the volume is too small."""
    if name == "gold_head":
        from capture.sim.head import head_mesh

        mesh = head_mesh().copy()
        turned = trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1])  # faces the robot
    elif name == "shiny_ball":
        mesh, turned = trimesh.creation.icosphere(subdivisions=6, radius=0.1), np.eye(4)
    else:
        raise SimulationError(f"scene '{name}' has no object", remedy="use gold_head or shiny_ball for an object trajectory")
    mesh.apply_transform(turned)
    lower, upper = mesh.bounds
    scale = min(1.0, float(np.min(size / (upper - lower))))
    middle, floor = (lower + upper) / 2, centre[2] - size[2] / 2
    mesh.apply_translation([-middle[0], -middle[1], -lower[2]])
    mesh.apply_scale(scale)
    mesh.apply_translation([centre[0], centre[1], floor])
    return mesh


def _table(centre: NDArray[np.float64], rng: np.random.Generator) -> Item:
    half = TABLE_SIZE / 2
    x, y = centre[:2]
    corners = [[x - half, y - half, 0], [x + half, y - half, 0], [x + half, y + half, 0], [x - half, y + half, 0]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return Item("table", mesh, Matt(textures.table_top(rng)), uv=uv)


def _props(centre: NDArray[np.float64], size: NDArray[np.float64], rng: np.random.Generator) -> list[Item]:
    """Low coloured blocks around the object: parallax for the pictures, colour for the metal."""
    colours = [
        (0.62, 0.10, 0.08),
        (0.10, 0.35, 0.60),
        (0.12, 0.48, 0.20),
        (0.70, 0.52, 0.10),
        (0.55, 0.55, 0.52),
        (0.35, 0.12, 0.45),
    ]
    reach = float(np.hypot(size[0], size[1])) / 2 + 0.045
    items = []
    for index, colour in enumerate(colours):
        angle = 2 * np.pi * (index + rng.uniform(-0.25, 0.25)) / len(colours)
        away = reach + rng.uniform(0.0, 0.08)
        edges = rng.uniform([0.03, 0.03, 0.015], [0.06, 0.06, 0.05])
        place = trimesh.transformations.rotation_matrix(rng.uniform(0, np.pi), [0, 0, 1])
        place[:3, 3] = [centre[0] + away * np.cos(angle), centre[1] + away * np.sin(angle), edges[2] / 2]
        block = trimesh.creation.box(edges) if index % 2 else trimesh.creation.cylinder(edges[0] / 2, edges[2], sections=48)
        block.apply_transform(place)
        items.append(Item(f"block {index}", block, Matt(np.array(colour, np.float32))))
    return items
