"""Reading mesh files of strangers: nothing beside the file is opened, and nothing is larger than the file can justify."""

import io
import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError

if TYPE_CHECKING:
    import trimesh

READABLE = (".ply", ".glb", ".obj", ".stl")
MAX_BYTES = 2**30
MAX_VERTICES = 2**25  # most vertices of a GLB file with every placed copy counted
MAX_COLUMNS = 64  # most properties of a vertex or face in a PLY file


def read(path: Path, *, process: bool = False) -> "trimesh.Trimesh":
    """The mesh in a file; with `process`, vertices at the same place are merged. Textures are ignored.

    Raises:
        UsageError: there is no such file, it is too large, or its suffix names no format of `READABLE`.
        DatasetError: it is damaged, holds no mesh, or asks for more memory than its size justifies.
    """
    import trimesh

    path = Path(path)
    kind = path.suffix.lower()
    if kind not in READABLE:
        raise UsageError("is no mesh file", where=path, why=f"suffix {kind!r}", remedy=f"valid: {', '.join(READABLE)}")
    data = files.read_regular(path, MAX_BYTES, suffixes=READABLE)
    options: dict[str, Any] = {"skip_materials": True} if kind in (".glb", ".obj") else {}
    try:
        if kind == ".glb":
            _check_glb(data, where=path)
        if kind == ".ply":
            _check_ply(data, where=path)
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind[1:], process=process, **options)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        sound = np.isfinite(vertices).all() and (len(faces) == 0 or 0 <= faces.min() <= faces.max() < len(vertices))
    except KoalaError:
        raise
    except Exception as error:  # trimesh raises whatever its parsers meet
        why = f"{type(error).__name__} {str(error)[:200]}"
        raise DatasetError("is no readable mesh", where=path, why=why, remedy="export it again") from None
    if not sound or not len(vertices):
        raise DatasetError("holds no mesh", where=path, why="no vertices, or impossible ones", remedy="export it again")
    return mesh


def _check_ply(data: bytes, *, where: Path) -> None:
    """Raise DatasetError where the header promises more rows than there are bytes."""
    end = data.find(b"end_header", 0, 2**16)
    words = [line.split() for line in data[: max(end, 0)].splitlines()]
    counts = [int(line[2]) for line in words if line[:1] == [b"element"] and len(line) == 3]
    if end < 0 or not all(0 <= count <= len(data) for count in counts):
        raise DatasetError("is cut off", where=where, why=f"its header says {counts} rows", remedy="copy it again")
    if sum(line[:1] == [b"property"] for line in words) > MAX_COLUMNS:
        raise DatasetError("holds too many properties", where=where, why=f"more than {MAX_COLUMNS}", remedy="export it again")


def _check_glb(data: bytes, *, where: Path) -> None:
    """Raise DatasetError where a GLB file refers to others, promises values it does not hold, or repeats its parts."""
    (length,) = struct.unpack_from("<I", data, 12)
    content = json.loads(data[20 : 20 + length])
    accessors, nodes = content.get("accessors", []), content.get("nodes", [])
    if any("uri" in part for key in ("buffers", "images") for part in content.get(key, [])):
        raise DatasetError("refers to other files", where=where, remedy="export it with everything in one file")
    if any("bufferView" not in accessor or "sparse" in accessor for accessor in accessors):
        raise DatasetError("promises values that it does not hold", where=where, remedy="export it again without compression")
    if not all(0 <= accessor["count"] <= len(data) for accessor in accessors):
        raise DatasetError("is cut off", where=where, why="more values expected than there are bytes", remedy="copy it again")
    children = [child for node in nodes for child in node.get("children", [])]
    if len(set(children)) < len(children):
        raise DatasetError("is no tree of parts", where=where, why="a part is inside two others", remedy="export it again")
    size = [
        sum(
            accessors[part["attributes"]["POSITION"]]["count"]
            + (accessors[part["indices"]]["count"] if part.get("indices") is not None else 0)
            for part in mesh["primitives"]
        )
        for mesh in content.get("meshes", [])
    ]
    placed = sum(size) + sum(size[node["mesh"]] for node in nodes if "mesh" in node)
    if placed > MAX_VERTICES:
        raise DatasetError("is too large", where=where, why=f"{placed} vertices and corners; at most {MAX_VERTICES} are read")
