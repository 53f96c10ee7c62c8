"""glTF 2.0 in one binary file, with the extension KHR_gaussian_splatting (Khronos, release candidate of 2026).

The numbers are those of the scene's world, where z is up. A node turns them to glTF's y up. Programs that do not know the
extension show coloured points.
"""

from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.reconstruct.asset.writing.glb import ARRAYS, FLOAT, binary
from koala3d.reconstruct.splats import harmonics
from koala3d.reconstruct.splats.splats import Splats

EXTENSION = "KHR_gaussian_splatting"
TURN = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
"""Quaternion of the node, w last: a quarter turn about x, from z up to y up."""
WORLD_FROM_FILE = ((1.0, 0, 0, 0), (0, 0, -1.0, 0), (0, 1.0, 0, 0), (0, 0, 0, 1.0))
"""Its inverse, as in files of assets."""
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def save(splats: Splats, path: Path) -> None:
    """Write splats as FILE.glb."""
    values = splats.coefficients
    plain = linear_from_srgb(harmonics.even(values))
    arrays = {
        "POSITION": splats.points,
        "COLOR_0": np.concatenate([plain, splats.opacities[:, None]], -1),
        f"{EXTENSION}:ROTATION": np.roll(splats.quaternions, -1, -1),
        f"{EXTENSION}:SCALE": splats.scales,
        f"{EXTENSION}:OPACITY": splats.opacities[:, None],
    }
    first = 0
    for degree, count in enumerate(np.bincount(harmonics.degrees())):
        for k in range(count):
            arrays[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"] = values[:, first + k]
        first += count
    parts = [np.ascontiguousarray(array, "<f4") for array in arrays.values()]
    starts = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": part.nbytes, "target": ARRAYS}
        for start, part in zip(starts, parts, strict=False)
    ]
    accessors: list[dict[str, Any]] = [
        {"bufferView": k, "componentType": FLOAT, "count": len(part), "type": KINDS[part.shape[1]]}
        for k, part in enumerate(parts)
    ]
    accessors[0] |= {"min": parts[0].min(0).tolist(), "max": parts[0].max(0).tolist()}
    field = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {name: k for k, name in enumerate(arrays)},
        "mode": 0,
        "extensions": {EXTENSION: field},
    }
    extras = {"base_from_asset": WORLD_FROM_FILE, "unit": "m" if splats.metric else "unknown", **splats.about}
    content = {
        "asset": {"version": "2.0", "generator": "koala", "extras": extras},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": splats.name, "rotation": TURN}],
        "meshes": [{"primitives": [primitive], "name": splats.name}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": starts[-1]}],
    }
    files.write_bytes(path, binary(content, b"".join(part.tobytes() for part in parts)))
