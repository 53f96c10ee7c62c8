"""glTF 2.0 in one binary file, with everything in it (Khronos, glTF 2.0 specification, section 4)."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.reconstruct.asset.asset import Asset
from koala3d.reconstruct.asset.certainty import MEANING
from koala3d.reconstruct.asset.writing.png import encoded

FLOAT, UNSIGNED = 5126, 5125
ARRAYS, INDICES = 34962, 34963  # targets of buffer views
SPECULAR = "KHR_materials_specular"


def save(asset: Asset, path: Path) -> None:
    """Write an asset as FILE.glb."""
    mesh, textures, parts = asset.mesh, asset.textures, _Parts()
    tangents = np.concatenate([mesh.tangents, mesh.signs[:, None]], -1)
    uv = np.stack([mesh.uv[:, 0], 1 - mesh.uv[:, 1]], -1)  # glTF's v grows downwards
    attributes = {
        "POSITION": parts.array(mesh.vertices, "VEC3", bounds=True),
        "NORMAL": parts.array(mesh.normals, "VEC3"),
        "TANGENT": parts.array(tangents, "VEC4"),
        "TEXCOORD_0": parts.array(uv, "VEC2"),
    }
    primitive = {"attributes": attributes, "indices": parts.indices(mesh.faces), "material": 0}
    surface = {"index": parts.texture("surface", textures.surface)}
    material: dict[str, Any] = {
        "name": asset.name,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": parts.texture("base_colour", textures.base_colour)},
            "metallicRoughnessTexture": surface,
        },
        "normalTexture": {"index": parts.texture("normal", textures.normal)},
        "occlusionTexture": surface,
        "extras": {"certaintyTexture": {"index": parts.texture("certainty", textures.certainty)}, "certainty": MEANING},
    }
    used = {}
    if textures.specular is not None:
        material["extensions"] = {SPECULAR: {"specularColorTexture": {"index": parts.texture("specular", textures.specular)}}}
        used = {"extensionsUsed": [SPECULAR]}
    extras = {"base_from_asset": asset.base_from_asset.tolist(), "unit": "m" if asset.metric else "unknown", **asset.about}
    content = {
        "asset": {"version": "2.0", "generator": "koala", "extras": extras},
        **used,
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": asset.name}],
        "meshes": [{"primitives": [primitive], "name": asset.name}],
        "materials": [material],
        **parts.content(),
    }
    files.write_bytes(path, binary(content, bytes(parts.data)))


class _Parts:
    """The binary part of a file while it grows, and what describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []

    def array(self, values: np.ndarray, kind: str, *, bounds: bool = False) -> int:
        """Index of the accessor of an array of floats."""
        stored = np.ascontiguousarray(values, "<f4")
        about = {"bufferView": self._view(stored.tobytes(), ARRAYS), "componentType": FLOAT, "count": len(stored), "type": kind}
        limits = {"min": stored.min(0).tolist(), "max": stored.max(0).tolist()} if bounds else {}
        self._accessors.append(about | limits)
        return len(self._accessors) - 1

    def indices(self, faces: np.ndarray) -> int:
        """Index of the accessor of triangles."""
        view = self._view(np.ascontiguousarray(faces, "<u4").tobytes(), INDICES)
        self._accessors.append({"bufferView": view, "componentType": UNSIGNED, "count": int(faces.size), "type": "SCALAR"})
        return len(self._accessors) - 1

    def texture(self, name: str, picture: np.ndarray) -> int:
        """Index of the texture of a picture."""
        self._images.append({"bufferView": self._view(encoded(picture)), "mimeType": "image/png", "name": name})
        return len(self._images) - 1

    def content(self) -> dict[str, Any]:
        """The JSON of all parts."""
        return {
            "textures": [{"source": index, "sampler": 0} for index in range(len(self._images))],
            "samplers": [{"magFilter": 9729, "minFilter": 9987}],  # linear; linear between levels
            "images": self._images,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self.data)}],
        }

    def _view(self, data: bytes, target: int | None = None) -> int:
        self.data.extend(b"\0" * (-len(self.data) % 4))
        self._views.append(
            {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)} | ({"target": target} if target else {})
        )
        self.data.extend(data)
        return len(self._views) - 1


def binary(content: dict[str, Any], data: bytes) -> bytes:
    """A GLB file: header and two chunks, JSON and data, each of a multiple of four bytes."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    text, data = text + b" " * (-len(text) % 4), data + b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
