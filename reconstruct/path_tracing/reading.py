"""What a renderer needs of an asset, from its GLB alone: trimesh reads mesh and textures, as other programs do."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import images

SPECULAR = "KHR_materials_specular"


@dataclass(frozen=True)
class StoredAsset:
    """A mesh with a metallic-roughness material. Pictures have their first row at v = 0, as glTF has it."""

    vertices: Float[np.ndarray, "v 3"]
    """In the asset's frame."""
    normals: Float[np.ndarray, "v 3"]
    uv: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    base_colour: Float[np.ndarray, "h w 3"]
    """Linear."""
    metallic: Float[np.ndarray, "h w 1"]
    roughness: Float[np.ndarray, "h w 1"]
    """The square root of GGX's alpha."""
    normal: Float[np.ndarray, "h w 3"]
    """(n + 1) / 2 along tangent, bitangent and normal."""
    specular: Float[np.ndarray, "h w 1"] | None
    """Factor on the reflectance of what is no metal; None: 1."""
    base_from_asset: Float[np.ndarray, "4 4"]


def read(path: Path) -> StoredAsset:
    """An asset as `reconstruct asset` wrote it. Raises DatasetError: it is no such file, or lacks what is needed here."""
    import trimesh

    try:
        content, data = _chunks(path.read_bytes())
        scene: Any = trimesh.load(path, process=False)
        (mesh,) = scene.geometry.values()  # as one mesh with `force`, it has other normals
        material = mesh.visual.material
        base, surface, normal = material.baseColorTexture, material.metallicRoughnessTexture, material.normalTexture
        frame = np.array(content["asset"]["extras"]["base_from_asset"], float).reshape(4, 4)
    except FileNotFoundError:
        raise DatasetError(
            "there is no such asset", where=path, remedy="reconstruct asset RUN --out FILE.glb makes one"
        ) from None
    except (ValueError, KeyError, AttributeError, IndexError, struct.error) as error:
        raise _refusal(path, f"{type(error).__name__}: {error}") from error
    missing = {"base colour": base, "metallic and roughness": surface, "normals": normal}
    if absent := [name for name, picture in missing.items() if picture is None]:
        raise _refusal(path, f"no texture of {', '.join(absent)}")
    pixels = lambda picture: np.asarray(picture.convert("RGB"), np.float32) / 255  # noqa: E731
    packed = pixels(surface)
    return StoredAsset(
        vertices=np.asarray(mesh.vertices, float),
        normals=np.asarray(mesh.vertex_normals, float),
        uv=np.asarray(mesh.visual.uv, float) * [1, -1] + [0, 1],  # trimesh's v grows upwards
        faces=np.asarray(mesh.faces, np.int64),
        base_colour=images.linear_from_srgb(pixels(base)),
        metallic=packed[..., 2:],
        roughness=packed[..., 1:2],
        normal=pixels(normal),
        specular=_specular(content, data),
        base_from_asset=frame,
    )


def _refusal(path: Path, why: str) -> DatasetError:
    return DatasetError("this is not an asset of 'reconstruct asset'", where=path, why=why, remedy="give a GLB that it wrote")


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary part of a GLB."""
    magic, length = data[:4], struct.unpack_from("<I", data, 12)[0]
    if magic != b"glTF":
        raise ValueError("not a GLB")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def _specular(content: dict[str, Any], data: bytes) -> Float[np.ndarray, "h w 1"] | None:
    """Mean over the channels of the specular factor, which trimesh does not read."""
    import cv2

    extension = content["materials"][0].get("extensions", {}).get(SPECULAR)
    if extension is None:
        return None
    image = content["images"][content["textures"][extension["specularColorTexture"]["index"]]["source"]]
    view = content["bufferViews"][image["bufferView"]]
    start = view.get("byteOffset", 0)
    stored = cv2.imdecode(np.frombuffer(data[start : start + view["byteLength"]], np.uint8), cv2.IMREAD_COLOR)
    return images.linear_from_srgb(np.asarray(stored, np.float32) / 255).mean(-1, keepdims=True)
