"""Points in PLY files: the vertices of ASCII and binary files, with every count checked before memory is allocated."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Byte order of each encoding; none for text."""
CHANNELS = ("red", "green", "blue")
LONGEST_HEADER, MAX_BYTES = 2**16, 2**31


def read_points(path: Path) -> NDArray[np.float64]:
    """(n, 3) vertices. Raises as `read_cloud` does, and DatasetError if a vertex is not finite."""
    cloud = read_cloud(path)
    if cloud.not_finite:
        raise DatasetError("points are not finite", where=path, why=f"{cloud.not_finite} of them", remedy="remove them")
    return cloud.points


@dataclass(frozen=True, eq=False)
class Cloud:
    """The vertices of a file."""

    points: NDArray[np.float64]
    """(n, 3) those that are finite."""
    colours: NDArray[np.uint8] | None
    """(n, 3) their sRGB; None if the file holds none in bytes."""
    not_finite: int
    """Vertices that were left out: programs write NaN where a sensor saw nothing."""


def read_cloud(path: Path) -> Cloud:
    """The vertices of a file. Raises DatasetError: it is no such file, or it is cut off."""
    data = files.read_regular(path, MAX_BYTES, suffixes=(".ply",))
    header = re.match(rb"ply\r?\n(.*?)end_header\r?\n", data[:LONGEST_HEADER], re.DOTALL)
    if header is None:
        raise DatasetError("is not a PLY file", where=path, why="it has no header")
    encoding, count, properties = _header(header[1].decode("ascii", "replace"), where=path)
    channels = [name for name in CHANNELS if (name, "u1") in properties]
    body = data[header.end() :]
    if encoding == "ascii":
        table = _from_text(body, count, len(properties), where=path)
        vertices = dict(zip((name for name, _ in properties), table.T, strict=True))
    else:
        layout = np.dtype([(name, ORDERS[encoding] + kind) for name, kind in properties])
        if count * layout.itemsize > len(body):
            raise DatasetError("is cut off", where=path, why=f"{count} vertices expected, {len(body)} bytes found")
        vertices = np.frombuffer(body, layout, count)
    points = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    finite = np.isfinite(points).all(1)
    left_out = int((~finite).sum())
    if len(channels) < len(CHANNELS):
        return Cloud(points[finite], None, left_out)
    colours = np.stack([vertices[channel] for channel in channels], axis=-1)[finite]
    if not ((colours >= 0) & (colours <= 255)).all():  # false for NaN too
        raise DatasetError("colours are not bytes", where=path)
    return Cloud(points[finite], colours.astype(np.uint8), left_out)


def write_points(path: Path, points: NDArray[np.float64], colours: NDArray[np.uint8] | None = None) -> None:
    """Write (n, 3) points as binary doubles, with their (n, 3) sRGB where it is known, atomically."""
    fields = [(axis, "<f8") for axis in "xyz"] + ([] if colours is None else [(channel, "u1") for channel in CHANNELS])
    vertices = np.zeros(len(points), fields)
    for name, column in zip(vertices.dtype.names or (), (*points.T, *(() if colours is None else colours.T)), strict=True):
        vertices[name] = column
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "".join(f"property {'double' if kind == '<f8' else 'uchar'} {name}\n" for name, kind in fields) + "end_header\n"
    files.write_bytes(path, header.encode() + vertices.tobytes())


def _header(text: str, *, where: Path) -> tuple[str, int, list[tuple[str, str]]]:
    """(encoding, number of vertices, their properties). Vertices must be the first element, as in all files of points."""
    encoding, count, properties, element = "", -1, [], ""
    try:
        for words in (line.split() for line in text.splitlines()):
            if words[:1] == ["format"]:
                encoding = words[1]
            elif words[:1] == ["element"]:
                element = words[1]
                count = int(words[2]) if element == "vertex" else count
                if element != "vertex" and count < 0:
                    raise DatasetError("vertices do not come first", where=where)
            elif words[:1] == ["property"] and element == "vertex":
                properties.append((words[2], TYPES[words[1]]))
    except (IndexError, KeyError, ValueError) as error:
        raise DatasetError("header cannot be read", where=where, why=str(error)) from None
    names = [name for name, _ in properties]
    if count < 0 or encoding not in ORDERS or len(set(names)) < len(names) or not {"x", "y", "z"} <= set(names):
        raise DatasetError("holds no readable points", where=where, why=f"format {encoding}, {count} vertices with {names}")
    return encoding, count, properties


def _from_text(body: bytes, count: int, width: int, *, where: Path) -> NDArray[np.float64]:
    """(count, width) numbers."""
    words = body.split()
    if count * width > len(words):
        raise DatasetError("is cut off", where=where, why=f"{count} vertices expected, {len(words)} numbers found")
    try:
        return np.array(words[: count * width], np.float64).reshape(count, width)
    except ValueError as error:
        raise DatasetError("vertex is not a number", where=where, why=str(error)) from None
