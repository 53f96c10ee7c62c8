"""The scenes of the simulated laboratory: shapes, materials and light on the table in front of the robot.

Everything is in the frame of the table [m]: its top at z = 0, z up. A stage is independent of the renderer.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from koala3d.capture.drivers.errors import SimulationError
from koala3d.capture.sim.laboratory import objects, textures
from koala3d.capture.sim.laboratory.materials import Glass, Material, Matt, Metal
from koala3d.capture.sim.laboratory.pieces import PIECES, bounds
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.recording import UPRIGHT

SCENES = {
    "gold_head": "a life-like head of rough gold on a plinth",
    "shiny_ball": "a mirror ball among coloured blocks",
    "lidar_guts": "the inside of a lidar: machined metal, circuit boards, a lens",
    "crystal_capture": "clear crystals on a stone",
    "mug": "a lacquered mug with a handle, on a foot ring",
    "board": "the calibration target of the trajectory",
    "grey_card": "an evenly lit grey card that fills the picture",
    "lens_cap": "darkness",
}
CARDS = {"grey_card": 0.9, "lens_cap": 0.0}  # light that comes from all of the picture; 1.5 fills a pixel in 10 ms
TABLE_SIZE = 1.8
STILL = frozenset({"table"})
"""Items that stand still where a turntable turns the object; what stands around the object turns with it."""


@dataclass(frozen=True)
class Item:
    """One thing on the stage, its mesh in the table's frame [m]."""

    name: str
    mesh: trimesh.Trimesh
    material: Material
    uv: NDArray[np.float32] | None = None  # (vertices, 2) texture coordinates, for a texture
    smooth: bool = False  # whether the mesh has its own normals


@dataclass(frozen=True)
class Stage:
    """All items of a scene. The first `parts` of them are the captured object."""

    name: str
    items: tuple[Item, ...]
    room: NDArray[np.float32]  # (h, 2h, 3) radiance of the surroundings, see `textures.room`
    parts: int = 1  # number of items that form the object

    @property
    def transparent(self) -> bool:
        """Whether any item is transparent."""
        return any(isinstance(item.material, Glass) for item in self.items)

    def mesh(self) -> trimesh.Trimesh:
        """The object in the table's frame [m]."""
        meshes = [item.mesh for item in self.items[: self.parts]]
        return meshes[0] if len(meshes) == 1 else objects.joined(meshes)


OBJECTS = tuple(name for name in SCENES if name != "board" and name not in CARDS)
VARIANTS = tuple(f"{name}-{piece}" for name in OBJECTS for piece in PIECES)


def check_name(name: str) -> str:
    """Return the name of a scene; raise UsageError with the nearest one if there is no such scene."""
    known = (*SCENES, *VARIANTS)
    if name not in known:
        raise UsageError(f"unknown scene '{name}'", remedy=nearest(name, known))
    return name


def stage(name: str, *, centre: ArrayLike, size: ArrayLike, seed: int, pose: str = UPRIGHT) -> Stage:
    """The stage of a scene. The object stands in the middle of the bottom of the object volume, or lies as in another pose.

    Args:
        name: a scene other than "board", with one of `PIECES` after a dash or without: "gold_head-dented".
        centre: (3,) centre of the object volume in the frame of the table [m].
        size: (3,) its edges [m].
        seed: of the textures.
        pose: a name; each but "upright" is another way to put the object down again, see `turned_over`.
    """
    rng = np.random.default_rng([seed, 11])
    centre, size = np.asarray(centre, np.float64), np.asarray(size, np.float64)
    drawn, _, piece = name.partition("-")
    parts = _parts(drawn, np.random.default_rng([seed, 12]))
    meshes = [mesh for _, mesh, _, _ in parts]
    _place(meshes, centre, size)
    if piece:
        meshes = PIECES[piece](meshes)
    if pose != UPRIGHT:
        turned_over(meshes, centre, np.random.default_rng([seed, 13, *pose.encode()]))
    things = [Item(part, mesh, made, smooth=smooth) for (part, _, made, smooth), mesh in zip(parts, meshes, strict=True)]
    return Stage(name, (*things, _table(centre, rng), *_props(centre, size, rng)), textures.room(rng), len(things))


def _parts(name: str, rng: np.random.Generator) -> list[objects.Part]:
    """Meshes of the object [m], a material each, around the origin."""
    if name == "gold_head":
        from koala3d.capture.sim.laboratory.head import head_mesh

        mesh = head_mesh().copy()
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1]))  # faces the robot
        return [("gold_head", mesh, Metal("Au", 0.12), True)]
    if name == "shiny_ball":
        return objects.shiny_ball()
    if name == "lidar_guts":
        return objects.lidar_guts(rng)
    if name == "crystal_capture":
        return objects.crystal_capture(rng)
    if name == "mug":
        return objects.mug()
    raise SimulationError(f"scene '{name}' has no object", remedy=f"for an object trajectory use one of {', '.join(OBJECTS)}")


def _place(meshes: list[trimesh.Trimesh], centre: NDArray[np.float64], size: NDArray[np.float64]) -> None:
    """Move the object to the middle of the bottom of the volume; scale it down if the volume is too small."""
    lower, upper = bounds(meshes)
    scale = min(1.0, float(np.min(size / (upper - lower))))
    middle, floor = (lower + upper) / 2, centre[2] - size[2] / 2
    for mesh in meshes:
        mesh.apply_translation([-middle[0], -middle[1], -lower[2]])
        mesh.apply_scale(scale)
        mesh.apply_translation([centre[0], centre[1], floor])


def turned_over(meshes: list[trimesh.Trimesh], centre: NDArray[np.float64], rng: np.random.Generator) -> None:
    """Turn the object over as a person does, about an axis that is nearly level, and put it down on the table again.

    It is turned by 180 degrees, give or take 20, about an axis tilted by up to 20 degrees, and moved by up to 2 cm each way.
    """
    tilt, towards, angle = np.deg2rad([rng.uniform(-20, 20), rng.uniform(0, 360), 180 + rng.uniform(-20, 20)])
    axis = [np.cos(tilt) * np.cos(towards), np.cos(tilt) * np.sin(towards), np.sin(tilt)]
    motion = trimesh.transformations.rotation_matrix(angle, axis, centre)
    for mesh in meshes:
        mesh.apply_transform(motion)
    lower, upper = bounds(meshes)
    shift = [*(centre[:2] - (lower + upper)[:2] / 2 + rng.uniform(-0.02, 0.02, 2)), -lower[2]]
    for mesh in meshes:
        mesh.apply_translation(shift)


def _table(centre: NDArray[np.float64], rng: np.random.Generator) -> Item:
    half = TABLE_SIZE / 2
    x, y = centre[:2]
    corners = [[x - half, y - half, 0], [x + half, y - half, 0], [x + half, y + half, 0], [x - half, y + half, 0]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    return Item("table", mesh, Matt(textures.table_top(rng)), uv=uv)


def _props(centre: NDArray[np.float64], size: NDArray[np.float64], rng: np.random.Generator) -> list[Item]:
    """Low coloured blocks around the object, for parallax and for reflections in metal."""
    red, blue, green, yellow = (0.62, 0.10, 0.08), (0.10, 0.35, 0.60), (0.12, 0.48, 0.20), (0.70, 0.52, 0.10)
    colours = [red, blue, green, yellow, (0.55, 0.55, 0.52), (0.35, 0.12, 0.45)]
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
