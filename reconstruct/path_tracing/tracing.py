"""Mitsuba's path tracer: shapes and light go in as its dictionaries, pictures come out. Its variant is to be chosen before."""

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float, Int

from koala3d.datasets.camera_model import Camera

MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])


def choose(using: str) -> None:
    """Compute with a variant of Mitsuba from now on."""
    mi.set_variant(using)
    mi.set_log_level(mi.LogLevel.Error)


class PathTraced:
    """Shapes in a light, loaded for pictures from any camera. Lamps themselves are not seen."""

    def __init__(self, content: dict[str, Any], *, edges: int, clip: tuple[float, float]) -> None:
        """Load a scene.

        Args:
            content: emitters and shapes by name.
            edges: most edges of a light path.
            clip: distances of the nearest and the farthest thing that is seen [scene unit].
        """
        self._scene = mi.load_dict({"type": "scene", **content})
        self._light = mi.load_dict({"type": "path", "max_depth": edges, "rr_depth": edges, "hide_emitters": True})
        self._clip = clip

    def change(self, name: str, value: Any) -> None:
        """Give one of the scene's parameters another value."""
        values = mi.traverse(self._scene)
        values[name] = value
        values.update()

    def picture(
        self, camera: Camera, scene_from_camera: Float[np.ndarray, "4 4"], *, paths: int, seed: int
    ) -> Float[np.ndarray, "height width 4"]:
        """Linear light, multiplied by alpha, and alpha: the share of each pixel that shows a shape.

        Args:
            camera: a pinhole with square pixels whose principal point is the middle of the picture.
            paths: light paths per pixel.
        """
        film = {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgba",
            "component_format": "float32",
        }
        sensor = {
            "type": "perspective",
            "film": film,
            "sampler": {"type": "multijitter"},
            "near_clip": self._clip[0],
            "far_clip": self._clip[1],
            "fov_axis": "x",
            "fov": float(np.rad2deg(2 * np.arctan(0.5 * camera.width / camera.fx))),
            "to_world": transform(scene_from_camera @ MITSUBA_FROM_OPENCV),
        }
        render: Any = mi.render  # its stubs do not accept an int as seed
        loaded = mi.load_dict(sensor)
        return np.array(render(self._scene, sensor=loaded, integrator=self._light, spp=paths, seed=seed), np.float32)


def transform(matrix: Float[np.ndarray, "4 4"]) -> Any:
    """A matrix as Mitsuba's transform."""
    made: Any = mi.ScalarTransform4f  # its stubs do not accept a matrix
    return made(matrix)


def surroundings(light: Path | Float[np.ndarray, "h w 3"], scene_from_surroundings: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Light from far away, by an equirectangular picture of it in a file or an array."""
    picture = {"filename": str(light)} if isinstance(light, Path) else {"bitmap": mi.Bitmap(light.astype(np.float32))}
    return {"type": "envmap", **picture, "to_world": transform(scene_from_surroundings)}


def texture(values: Float[np.ndarray, "h w channels"]) -> dict[str, Any]:
    """Linear values, not to be taken as sRGB."""
    pixels = np.ascontiguousarray(values, np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "wrap_mode": "clamp"}


def mesh(
    material: dict[str, Any],
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    uv: Float[np.ndarray, "v 2"] | None = None,
    attributes: dict[str, Float[np.ndarray, "v *channels"]] | None = None,
) -> Any:
    """A mesh of one material.

    Args:
        material: Mitsuba's dictionary of a BSDF.
        uv: texture coordinates. v = 0 is the first row.
        attributes: further values of the vertices, by name.
    """
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(material)
    has = {"has_vertex_normals": True, "has_vertex_texcoords": uv is not None}
    shape: Any = mi.Mesh("mesh", len(vertices), len(faces), props=properties, **has)
    values = mi.traverse(shape)
    values["vertex_positions"] = vertices.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values["vertex_normals"] = normals.astype(np.float32).ravel()
    if uv is not None:
        values["vertex_texcoords"] = uv.astype(np.float32).ravel()
    values.update()
    for name, of_vertices in (attributes or {}).items():
        shape.add_attribute(name, of_vertices.size // len(vertices), of_vertices.astype(np.float32).ravel())
    return shape
