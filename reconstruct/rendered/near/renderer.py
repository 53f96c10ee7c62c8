"""Light of a near scene by Mitsuba's path tracer, whose variant is to be chosen before.

Light is told apart by what the camera sees first. Metal and glass have specular light only, matte surfaces diffuse light only.
Where a material has both, the scene is rendered with either part of it: their sum is the picture, as long as the solid is
convex and alone and so receives none of its own light.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.path_tracing.tracing import PathTraced, choose, mesh, surroundings
from koala3d.reconstruct.rendered.near.materials import Coated, Glass, Material, Matte, Metal, Partly
from koala3d.reconstruct.rendered.near.scenes import LAMP_RADIUS, ROOM, NearScene

EDGES, CLEAR_EDGES = 6, 12
"""Most edges of a light path, without glass and with it."""
PATHS = 16
"""Light paths per ray of a picture."""
DRAWS = 4
"""Pictures that are rendered at most until each pixel is finite in one."""
SHARP = 1e6
"""Concentration of a lobe that leaves the room's light as it is."""
ROOM_SIZE = (128, 256)
"""Rows and columns of the picture of the room."""
SCENE_FROM_ROOM = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1]])
"""Mitsuba's surroundings have their zenith along y."""
COLOUR = {"type": "mesh_attribute", "name": "vertex_colour"}
"""Colour of a mesh's vertices."""
Kind = Literal["all", "diffuse", "specular"]


@dataclass(frozen=True)
class Mesh:
    """A part's surface: (n, 3) vertices and outward unit normals, (m, 3) faces; unit of the scene."""

    vertices: NDArray[np.float64]
    normals: NDArray[np.float32]
    faces: NDArray[np.int64]


class Renderer:
    """A near scene, loaded for rendering from any camera."""

    def __init__(self, scene: NearScene, meshes: tuple[Mesh, ...], *, using: str) -> None:
        choose(using)
        materials = [part.material for part in scene.parts]
        kinds: tuple[Kind, ...] = ("diffuse", "specular") if _mixed(materials) else ("all",)
        self._scenes: dict[Kind, PathTraced] = {kind: loaded(scene, meshes, kind) for kind in kinds}
        self._is_diffuse = np.array([isinstance(material, Matte) for material in materials])

    def parts_of_light(
        self, camera: Camera, scene_from_camera: NDArray[np.float64], part: NDArray[np.int64], *, seed: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Diffuse and specular light (height, width, 3) of what each pixel's middle shows, linear.

        Args:
            camera: a pinhole with square pixels whose principal point is the middle of the picture.
            part: (height, width) index of the part seen in each pixel's middle; -1: none.
        """
        found = {kind: self._rendered(kind, camera, scene_from_camera, seed) for kind in self._scenes}
        if "all" not in found:
            return found["diffuse"], found["specular"]
        diffuse = (part >= 0) & self._is_diffuse[part]
        return np.where(diffuse[..., None], found["all"], 0), np.where(diffuse[..., None], 0, found["all"])

    def _rendered(self, kind: Kind, camera: Camera, scene_from_camera: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
        """Mean light of those paths of a pixel that meet a solid.

        A path that grazes rough metal may carry a value that is not finite; its pixel is drawn again.
        """
        light = np.full((camera.height, camera.width, 3), np.nan)
        for again in range(DRAWS):
            drawn = (seed + again) % 2**32
            picture = self._scenes[kind].picture(camera, scene_from_camera, paths=PATHS, seed=drawn).astype(float)
            missing = ~np.isfinite(light).all(-1)
            light[missing] = (picture[..., :3] / np.maximum(picture[..., 3:], 0.5 / PATHS))[missing]
            if np.isfinite(light).all():
                return light
        raise ReconstructError(
            "light is not finite", why=f"{DRAWS} pictures have it in the same pixel", remedy="set KOALA_RENDERER=scalar_rgb"
        )


def loaded(scene: NearScene, meshes: tuple[Mesh, ...], kind: Kind) -> PathTraced:
    """The scene with one kind of light, or all of it."""
    materials = [part.material for part in scene.parts]
    shapes = {f"part{number}": _shape(*pair, kind) for number, pair in enumerate(zip(materials, meshes, strict=True))}
    edges = CLEAR_EDGES if any(isinstance(material, Glass) for material in materials) else EDGES
    return PathTraced({"room": _room(scene), **_lamps(scene), **shapes}, edges=edges, clip=(0.05, 100.0))


def _mixed(materials: list[Material]) -> bool:
    return any(isinstance(material, Coated | Partly) for material in materials)


def _room(scene: NearScene) -> dict[str, Any]:
    rows, columns = ROOM_SIZE
    down, around = np.pi * (np.arange(rows) + 0.5) / rows, 2 * np.pi * (np.arange(columns) + 0.5) / columns
    down, around = np.meshgrid(down, around, indexing="ij")
    # column u looks along (sin, cos down, -cos) of the angle 2 pi u in Mitsuba's frame
    looking = np.stack([np.sin(down) * np.sin(around), np.cos(down), -np.sin(down) * np.cos(around)]).reshape(3, -1)
    light = ROOM * np.asarray(scene.room.convolved(SCENE_FROM_ROOM[:3, :3] @ looking, SHARP)).T.reshape(rows, columns, 3)
    return surroundings(light, SCENE_FROM_ROOM)


def _lamps(scene: NearScene) -> dict[str, Any]:
    glow = lambda colour: {"type": "area", "radiance": {"type": "rgb", "value": list(colour)}}  # noqa: E731
    return {
        f"lamp{number}": {"type": "sphere", "center": list(lamp.place), "radius": LAMP_RADIUS, "emitter": glow(lamp.colour)}
        for number, lamp in enumerate(scene.lamps)
    }


def _shape(material: Material, part: Mesh, kind: Kind) -> Any:
    brushed = isinstance(material, Metal) and material.across is not None
    uv = part.vertices[:, [2, 0]] if brushed else None  # u grows along circles around x: tangents need no map without seams
    attributes = {}
    if isinstance(material, Matte | Partly):
        attributes["vertex_colour"] = material.colour(part.vertices)
    if isinstance(material, Coated | Partly):
        attributes["vertex_share"] = material.share(part.vertices)
    return mesh(_bsdf(material, kind), part.vertices, part.normals, part.faces, uv=uv, attributes=attributes)


def _bsdf(material: Material, kind: Kind) -> dict[str, Any]:
    shown = lambda this: 1.0 if kind in ("all", this) else 0.0  # noqa: E731
    match material:
        case Metal(name, roughness, across):
            alpha = {"alpha": roughness} if across is None else {"alpha_u": roughness, "alpha_v": across}
            light = {"specular_reflectance": {"type": "rgb", "value": shown("specular")}}
            return {"type": "roughconductor", "material": name, "distribution": "ggx", **alpha, **light}
        case Glass(refraction):
            return {"type": "dielectric", "int_ior": refraction, "ext_ior": 1.0}
        case Coated(first, second, _, roughness):
            coat = {"type": "roughplastic", "distribution": "ggx", "alpha": roughness, "specular_reflectance": shown("specular")}
            lit = lambda colour: [shown("diffuse") * channel for channel in colour]  # noqa: E731
            return _blended(*({**coat, "diffuse_reflectance": {"type": "rgb", "value": lit(body)}} for body in (first, second)))
        case Partly(_, metal, _):
            matte = {"type": "diffuse", "reflectance": COLOUR if shown("diffuse") else 0.0}
            return _blended(matte, _bsdf(metal, kind))
        case Matte():
            return {"type": "diffuse", "reflectance": COLOUR}


def _blended(first: dict[str, Any], second: dict[str, Any]) -> dict[str, Any]:
    weight = {"type": "mesh_attribute", "name": "vertex_share"}
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}
