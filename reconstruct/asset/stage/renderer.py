"""Pictures of an asset by Mitsuba's path tracer. Imports Mitsuba, whose variant is to be chosen before.

    metallic-roughness material    `principled` (Burley 2012) inside `normalmap`
    light                          `envmap`, from the EXR or an array

All lengths and directions are in the asset's frame, y up, which is Mitsuba's for surroundings.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float, Int

from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.asset.stage.reading import StoredAsset
from koala3d.reconstruct.asset.stage.sensor import MITSUBA_FROM_OPENCV, pinhole

EDGES = 6
"""Most edges of a light path: the asset mirrors itself."""
ASSET_FROM_SURROUNDINGS = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
"""Mitsuba's surroundings have z in the middle column and -x to the right of it; ours x, and z to the right."""
GLASS = 0.5  # of `principled`: reflectance 0.04


class Renderer:
    """An asset in a light, loaded for rendering from any camera."""

    def __init__(self, asset: StoredAsset, light: Path | Float[np.ndarray, "h w 3"], *, using: str) -> None:
        mi.set_variant(using)
        mi.set_log_level(mi.LogLevel.Error)
        around = {"filename": str(light)} if isinstance(light, Path) else {"bitmap": mi.Bitmap(light.astype(np.float32))}
        surroundings = {"type": "envmap", **around, "to_world": _transform(ASSET_FROM_SURROUNDINGS)}
        self._turned = 0.0
        self._scene = mi.load_dict({"type": "scene", "surroundings": surroundings, **_shapes(asset)})
        self._light = mi.load_dict({"type": "path", "max_depth": EDGES, "rr_depth": EDGES, "hide_emitters": True})

    def turn_light(self, angle: float) -> None:
        """Turn the light about the upward axis, counterclockwise seen from above, from how it was loaded [rad]."""
        if angle == self._turned:
            return
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = np.array([[cosine, 0, sine, 0], [0, 1.0, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1]])
        values = mi.traverse(self._scene)
        values["surroundings.to_world"] = _transform(turned @ ASSET_FROM_SURROUNDINGS)
        values.update()
        self._turned = angle

    def picture(
        self, camera: Camera, asset_from_camera: Float[np.ndarray, "4 4"], *, paths: int, seed: int
    ) -> Float[np.ndarray, "height width 4"]:
        """Linear light, multiplied by alpha, and alpha: which share of each pixel shows the asset.

        Args:
            camera: a pinhole with square pixels whose principal point is the middle of the picture.
            paths: light paths per pixel.
        """
        render: Any = mi.render  # its stubs do not accept an int as seed
        found = render(self._scene, sensor=_sensor(camera, asset_from_camera), integrator=self._light, spp=paths, seed=seed)
        return np.array(found, np.float32)


def _shapes(asset: StoredAsset) -> dict[str, Any]:
    """The mesh in two parts: Mitsuba's bitangent is always normal x tangent; where charts lie mirrored, normals are turned."""
    u, v = np.moveaxis(asset.uv[asset.faces] * [1, -1], -1, 0)
    mirrored = (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) < (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0])
    turned = replace(asset, normal=asset.normal * [1, -1, 1] + [0, 1, 0])
    parts = {"plain": (asset, asset.faces[~mirrored]), "mirrored": (turned, asset.faces[mirrored])}
    return {name: _shape(part, faces) for name, (part, faces) in parts.items() if len(faces)}


def _shape(asset: StoredAsset, faces: Int[np.ndarray, "f 3"]) -> Any:
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_material(asset))
    used, faces = np.unique(faces, return_inverse=True)
    shape = mi.Mesh(
        "asset", len(used), len(faces.reshape(-1, 3)), props=properties, has_vertex_normals=True, has_vertex_texcoords=True
    )
    values = mi.traverse(shape)
    values["vertex_positions"] = asset.vertices[used].astype(np.float32).ravel()
    values["vertex_normals"] = asset.normals[used].astype(np.float32).ravel()
    values["vertex_texcoords"] = asset.uv[used].astype(np.float32).ravel()  # v = 0 is the first row here, too
    values["faces"] = faces.astype(np.uint32).ravel()
    values.update()
    return shape


def _material(asset: StoredAsset) -> dict[str, Any]:
    shared = {
        "type": "principled",
        "base_color": _texture(asset.base_colour),
        "metallic": _texture(asset.metallic),
        "roughness": _texture(asset.roughness),
    }
    surface: dict[str, Any] = {**shared, "specular": GLASS}
    if asset.specular is not None:  # `principled` takes one number: a mixture of glass and of what mirrors nothing has the factor
        weight = _texture(asset.specular)
        surface = {"type": "blendbsdf", "weight": weight, "first": {**shared, "specular": 0.0}, "second": surface}
    return {"type": "normalmap", "normalmap": _texture(asset.normal), "bsdf": surface}


def _texture(values: Float[np.ndarray, "h w channels"]) -> dict[str, Any]:
    """Linear values, not to be taken as sRGB."""
    pixels = np.ascontiguousarray(values, np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "wrap_mode": "clamp"}


def _sensor(camera: Camera, asset_from_camera: Float[np.ndarray, "4 4"]) -> Any:
    return mi.load_dict(pinhole(camera, _transform(asset_from_camera @ MITSUBA_FROM_OPENCV), clip=(1e-3, 1e4)))


def _transform(matrix: Float[np.ndarray, "4 4"]) -> Any:
    transform: Any = mi.ScalarTransform4f  # its stubs do not accept a matrix
    return transform(matrix)
