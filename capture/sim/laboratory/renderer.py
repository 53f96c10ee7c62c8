"""Rendering of a stage with Mitsuba 3. The only module that imports it."""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sim.laboratory.lens import strips
from koala3d.capture.sim.laboratory.materials import Glass, Material, Metal, Plastic
from koala3d.capture.sim.laboratory.scenes import STILL, Item, Stage
from koala3d.datasets.camera_model import Camera

MAX_DEPTH = 3  # edges of a light path: camera - object - table - light
CLEAR_DEPTH = 8  # the same with glass, which light enters and leaves several times
SAMPLER = "multijitter"
"""Correlated stratification: at 16 samples per pixel 4 dB less noise than independent ones, for the same time."""
PATHS_AT_ONCE = 4_000_000  # larger pictures are rendered in strips, which keeps the vectorised variant below 1 GB
MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])  # Mitsuba's cameras have x left, y up, z forward
BASE_FROM_ROOM = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1]])
"""Mitsuba's surroundings have their zenith along y."""


@dataclass(frozen=True)
class Surfaces:
    """The first surface along one ray per pixel of a pinhole."""

    hit: NDArray[np.bool_]  # (h, w) whether the ray hits something
    is_object: NDArray[np.bool_]  # (h, w) whether it hits the object
    normals: NDArray[np.float32]  # (h, w, 3) unit, outward, in the table's frame
    depth: NDArray[np.float32]  # (h, w) along z of the camera [m]; 0 without a hit


class Renderer:
    """One stage, loaded for rendering from any camera.

    Args:
        using: variant of Mitsuba, to be chosen before this module is imported: Mitsuba loads LLVM then.
    """

    def __init__(self, stage: Stage, *, using: str) -> None:
        mi.set_variant(using)
        mi.set_log_level(mi.LogLevel.Error)
        self.stage = stage
        self._shapes = {f"item{index:03d}": _shape(item) for index, item in enumerate(stage.items)}
        self._base_from_room = BASE_FROM_ROOM
        self.light(stage.room)
        depth = CLEAR_DEPTH if stage.transparent else MAX_DEPTH
        self._light = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth})
        self._first = mi.load_dict({"type": "aov", "aovs": "normal:sh_normal,place:position,shape:shape_index"})
        identities = [shape.id() for shape in self._scene.shapes()]
        self._object_indices = [identities.index(f"item{part:03d}") + 1 for part in range(stage.parts)]  # 0 is a miss

    def light(self, room: NDArray[np.float32]) -> None:
        """Take (h, 2h, 3) other surroundings, in the place of those before."""
        surroundings = {"type": "envmap", "bitmap": mi.Bitmap(room), "to_world": _transform(self._base_from_room)}
        self._scene = mi.load_dict({"type": "scene", "surroundings": surroundings, **self._shapes})

    def place_room(self, table_from_room: NDArray[np.float64]) -> None:
        """Move the items that stand still before a turning object, and the surroundings with their lamps, by a (4, 4) motion."""
        values = mi.traverse(self._scene)
        self._base_from_room = table_from_room @ BASE_FROM_ROOM
        values["surroundings.to_world"] = _transform(self._base_from_room)
        for index, item in enumerate(self.stage.items):
            if item.name in STILL:
                places = np.asarray(item.mesh.vertices) @ table_from_room[:3, :3].T + table_from_room[:3, 3]
                values[f"item{index:03d}.vertex_positions"] = np.asarray(places, np.float32).ravel()
        values.update()

    def radiance(
        self, pinhole: Camera, table_from_camera: NDArray[np.float64], *, samples: int, seed: int
    ) -> NDArray[np.float32]:
        """(h, w, 3) linear light that reaches a pinhole, from `samples` paths per pixel.

        The pixels of the pinhole must be square and its principal point the corner of a pixel.
        """
        picture = np.empty((pinhole.height, pinhole.width, 3), np.float32)
        for number, (rows, part) in enumerate(strips(pinhole, PATHS_AT_ONCE // samples)):
            sensor = _sensor(part, table_from_camera, SAMPLER)
            light = self._render(sensor, self._light, samples, strip_seed(seed, number))
            picture[rows] = light[..., :3]
        return picture

    def _render(self, sensor: Any, integrator: Any, samples: int, seed: int) -> NDArray[Any]:
        render: Any = mi.render  # its stubs do not accept an int as seed
        return np.array(render(self._scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed))

    def surfaces(self, pinhole: Camera, table_from_camera: NDArray[np.float64], *, seed: int) -> Surfaces:
        """The first surface at each pixel of the pinhole."""
        sensor = _sensor(pinhole, table_from_camera, "independent")
        picture = np.asarray(self._render(sensor, self._first, 1, seed), np.float32)
        normals, places, index = picture[..., :3], picture[..., 3:6], picture[..., 6]
        away = places - table_from_camera[:3, 3].astype(np.float32)
        leaked = np.sum(normals * away, axis=-1) > 0.3 * np.linalg.norm(away, axis=-1)  # slipped between two triangles
        hit = (np.linalg.norm(normals, axis=-1) > 0.5) & ~leaked
        depth = away @ table_from_camera[:3, 2]
        on_object = hit & np.isin(np.rint(index), self._object_indices)
        return Surfaces(hit, on_object, normals, np.where(hit, depth, 0).astype(np.float32))


def strip_seed(seed: int, number: int) -> int:
    """A different seed for each strip of a picture, so that their noise differs."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _sensor(pinhole: Camera, table_from_camera: NDArray[np.float64], sampler: str) -> Any:
    """Mitsuba's sensor for a pinhole: a crop of the smallest centred picture that contains it."""
    half_width = int(np.ceil(max(pinhole.cx, pinhole.width - pinhole.cx)))
    half_height = int(np.ceil(max(pinhole.cy, pinhole.height - pinhole.cy)))
    film = {
        "type": "hdrfilm",
        "width": 2 * half_width,
        "height": 2 * half_height,
        "rfilter": {"type": "box"},
        "crop_offset_x": round(half_width - pinhole.cx),
        "crop_offset_y": round(half_height - pinhole.cy),
        "crop_width": pinhole.width,
        "crop_height": pinhole.height,
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    sensor = {
        "type": "perspective",
        "film": film,
        "sampler": {"type": sampler},
        "near_clip": 0.005,
        "far_clip": 100.0,
        "fov_axis": "x",
        "fov": float(np.rad2deg(2 * np.arctan(half_width / pinhole.fx))),
        "to_world": _transform(table_from_camera @ MITSUBA_FROM_OPENCV),
    }
    return mi.load_dict(sensor)


def _transform(matrix: NDArray[np.float64]) -> Any:
    transform: Any = mi.ScalarTransform4f  # its stubs do not accept a matrix
    return transform(matrix)


def _shape(item: Item) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_material(item.material))
    vertices, faces = np.asarray(item.mesh.vertices, np.float32), np.asarray(item.mesh.faces, np.uint32)
    has = {"has_vertex_normals": item.smooth, "has_vertex_texcoords": item.uv is not None}
    mesh = mi.Mesh(item.name, len(vertices), len(faces), props=properties, **has)
    values = mi.traverse(mesh)
    values["vertex_positions"], values["faces"] = vertices.ravel(), faces.ravel()
    if item.smooth:
        values["vertex_normals"] = np.asarray(item.mesh.vertex_normals, np.float32).ravel()
    if item.uv is not None:
        values["vertex_texcoords"] = item.uv.ravel()
    values.update()
    return mesh


def _material(material: Material) -> dict[str, Any]:
    if isinstance(material, Metal):
        return {"type": "roughconductor", "material": material.name, "distribution": "ggx", "alpha": material.roughness}
    if isinstance(material, Glass):
        return {"type": "dielectric", "int_ior": material.refraction, "ext_ior": 1.0}
    if isinstance(material, Plastic):
        body = {"type": "rgb", "value": list(material.colour)}
        coated = {"type": "roughplastic", "distribution": "ggx", "alpha": material.roughness, "diffuse_reflectance": body}
        return {"type": "twosided", "inner": coated}
    if material.reflectance.ndim == 1:
        colour: dict[str, Any] = {"type": "rgb", "value": material.reflectance.tolist()}
    else:
        colour = {"type": "bitmap", "bitmap": mi.Bitmap(material.reflectance), "raw": True}
    return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": colour}}
