"""Pictures of an asset by Mitsuba's path tracer, whose variant is to be chosen before.

    metallic-roughness material    `principled` (Burley 2012) inside `normalmap`
    light                          `envmap`, from the EXR or an array

All lengths and directions are in the asset's frame, y up, which is Mitsuba's for surroundings.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from koala3d.datasets.camera_model import Camera
from koala3d.reconstruct.path_tracing.reading import StoredAsset
from koala3d.reconstruct.path_tracing.tracing import PathTraced, choose, mesh, surroundings, texture, transform

EDGES = 6
"""Most edges of a light path: the asset mirrors itself."""
ASSET_FROM_SURROUNDINGS = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
"""Mitsuba's surroundings have z in the middle column and -x to the right of it; ours x, and z to the right."""
GLASS = 0.5  # of `principled`: reflectance 0.04


class Renderer:
    """An asset in a light, loaded for rendering from any camera."""

    def __init__(self, asset: StoredAsset, light: Path | Float[np.ndarray, "h w 3"], *, using: str) -> None:
        choose(using)
        around = surroundings(light, ASSET_FROM_SURROUNDINGS)
        self._turned = 0.0
        self._scene = PathTraced({"surroundings": around, **_shapes(asset)}, edges=EDGES, clip=(1e-3, 1e4))

    def turn_light(self, angle: float) -> None:
        """Turn the light about the upward axis, counterclockwise seen from above, from how it was loaded [rad]."""
        if angle == self._turned:
            return
        cosine, sine = np.cos(angle), np.sin(angle)
        turned = np.array([[cosine, 0, sine, 0], [0, 1.0, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1]])
        self._scene.change("surroundings.to_world", transform(turned @ ASSET_FROM_SURROUNDINGS))
        self._turned = angle

    def picture(
        self, camera: Camera, asset_from_camera: Float[np.ndarray, "4 4"], *, paths: int, seed: int
    ) -> Float[np.ndarray, "height width 4"]:
        """See `PathTraced.picture`."""
        return self._scene.picture(camera, asset_from_camera, paths=paths, seed=seed)


def _shapes(asset: StoredAsset) -> dict[str, Any]:
    """The mesh in two parts: Mitsuba's bitangent is always normal x tangent; where charts lie mirrored, normals are turned."""
    u, v = np.moveaxis(asset.uv[asset.faces] * [1, -1], -1, 0)
    mirrored = (u[:, 1] - u[:, 0]) * (v[:, 2] - v[:, 0]) < (u[:, 2] - u[:, 0]) * (v[:, 1] - v[:, 0])
    turned = replace(asset, normal=asset.normal * [1, -1, 1] + [0, 1, 0])
    parts = {"plain": (asset, asset.faces[~mirrored]), "mirrored": (turned, asset.faces[mirrored])}
    return {name: _shape(part, faces) for name, (part, faces) in parts.items() if len(faces)}


def _shape(asset: StoredAsset, faces: Int[np.ndarray, "f 3"]) -> Any:
    used, faces = np.unique(faces, return_inverse=True)
    values = (asset.vertices[used], asset.normals[used], faces.reshape(-1, 3))
    return mesh(_material(asset), *values, uv=asset.uv[used])


def _material(asset: StoredAsset) -> dict[str, Any]:
    shared = {
        "type": "principled",
        "base_color": texture(asset.base_colour),
        "metallic": texture(asset.metallic),
        "roughness": texture(asset.roughness),
    }
    surface: dict[str, Any] = {**shared, "specular": GLASS}
    if asset.specular is not None:  # `principled` takes one number: a mixture of glass and of what mirrors nothing has the factor
        weight = texture(asset.specular)
        surface = {"type": "blendbsdf", "weight": weight, "first": {**shared, "specular": 0.0}, "second": surface}
    return {"type": "normalmap", "normalmap": texture(asset.normal), "bsdf": surface}
