"""Reader of COLMAP's model files, text and binary: every count and reference is checked before it is used.

A model is three files, `cameras`, `images` and `points3D`. Version 4 adds `rigs` and `frames`, which repeat what the poses in
`images` already contain. Writing goes through pycolmap.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats import ply

MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16), 12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6), 17: ("EQUIRECTANGULAR", 2),
}  # fmt: skip
"""Name and number of parameters of each lens model, by its number in the file."""
NOWHERE = 2**64 - 1
"""Point id of a feature without a point."""
LONGEST_NAME, MAX_BYTES = 4096, 2**32
PAIRS = "the line after each image holds its features, X Y POINT3D_ID each, and may be empty, but not missing"


@dataclass(frozen=True)
class StoredCamera:
    """One camera as stored."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class StoredImage:
    """One image as stored."""

    name: str
    camera_id: int
    camera_from_world: NDArray[np.float64]
    pixels: NDArray[np.float64]
    """(k, 2) features, first pixel's centre at (0.5, 0.5)."""
    points: NDArray[np.int64]
    """(k,) row of each feature's point in `Model.points`; -1 for none."""


@dataclass(eq=False)
class Model:
    """A whole model."""

    cameras: dict[int, StoredCamera] = field(default_factory=dict)
    images: list[StoredImage] = field(default_factory=list)
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    colours: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))


def read_model(cameras: Path, images: Path, points: Path | None) -> Model:
    """Read the files of a model, all binary or all text; there may be no points, or points in a PLY file.

    Raises:
        DatasetError: a file is cut off, is shorter than its counts say, or refers to a missing record.
    """
    binary = cameras.suffix == ".bin"
    model = Model()
    model.cameras = dict(_cameras_binary(cameras) if binary else _cameras_text(cameras))
    ids, model.points, model.colours = _points(points)
    if len(np.unique(ids)) < len(ids):
        raise DatasetError("point is listed twice", where=points)
    order = np.argsort(ids)
    for image_id, name, camera_id, quaternion_translation, pixels, point_ids in (
        _images_binary(images) if binary else _images_text(images)
    ):
        where = f"{images}, image {image_id} ({name})"
        if camera_id not in model.cameras:
            raise DatasetError("camera is missing", where=where, why=f"there is no camera {camera_id} in {cameras.name}")
        values = np.asarray(quaternion_translation, np.float64)
        if not np.isfinite(values).all() or not np.linalg.norm(values[:4]) > 1e-9:
            raise DatasetError("pose is not finite", where=where, remedy="drop the image")
        matrix = pose.from_quaternion(values[:4], values[4:])
        model.images.append(StoredImage(name, camera_id, matrix, pixels, _rows(point_ids, ids[order], order)))
    return model


def _points(path: Path | None) -> tuple[NDArray[np.uint64], NDArray[np.float64], NDArray[np.uint8]]:
    """Numbers of the points, (n, 3) positions and (n, 3) sRGB. No image refers to the points of a PLY file."""
    if path is None:
        return np.zeros(0, np.uint64), np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if path.suffix != ".ply":
        return _points_binary(path) if path.suffix == ".bin" else _points_text(path)
    cloud = ply.read_cloud(path)
    grey = np.full((len(cloud.points), 3), 128, np.uint8)
    return (
        NOWHERE - 1 - np.arange(len(cloud.points), dtype=np.uint64),
        cloud.points,
        grey if cloud.colours is None else cloud.colours,
    )


def count_images(path: Path) -> int:
    """Number of images that the file `images` of a model states or, as text, lists."""
    if path.suffix == ".bin":
        return _Cursor(path).count(64 + 1 + 8, "images")
    return sum(1 for _ in _lines(path, keep_empty=True)) // 2


def _rows(point_ids: NDArray[np.uint64], sorted_ids: NDArray[np.uint64], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) row of each point id; -1 for ids without a point."""
    if not len(sorted_ids):
        return np.full(len(point_ids), -1)
    place = np.minimum(np.searchsorted(sorted_ids, point_ids), len(sorted_ids) - 1)
    return np.where(sorted_ids[place] == point_ids, order[place], -1)


class _Cursor:
    """A position in a binary file that never moves beyond its end."""

    def __init__(self, path: Path) -> None:
        self.path, self.place = path, 0
        self.data = files.read_regular(path, MAX_BYTES)

    def take(self, layout: str) -> tuple[Any, ...]:
        """The next values, little-endian, laid out as `struct` says."""
        size = struct.calcsize("<" + layout)
        self.need(size)
        values = struct.unpack_from("<" + layout, self.data, self.place)
        self.place += size
        return values

    def need(self, size: int) -> None:
        """Raise where fewer than `size` bytes are left."""
        if size > len(self.data) - self.place:
            why = f"{size} bytes expected at {self.place}, the file has {len(self.data)}"
            raise DatasetError("is cut off", where=self.path, why=why, remedy="copy it again")

    def count(self, least: int, what: str) -> int:
        """A number of records of at least `least` bytes each."""
        (number,) = self.take("Q")
        return self.room_for(least, number, what)

    def room_for(self, least: int, number: int, what: str) -> int:
        """`number`, if so many records of at least `least` bytes each can follow."""
        room = (len(self.data) - self.place) // least
        if number > room:
            why = f"{number} {what}, there is room for {room}"
            raise DatasetError(f"promises more {what} than it holds", where=self.path, why=why, remedy="copy it again")
        return number

    def text(self) -> str:
        """Text up to the next zero byte."""
        end = self.data.find(b"\0", self.place, self.place + LONGEST_NAME)
        if end < 0:
            raise DatasetError("name is not terminated", where=self.path, why=f"at byte {self.place}", remedy="copy it again")
        found = self.data[self.place : end].decode("utf-8", "surrogateescape")
        self.place = end + 1
        return found


def _cameras_binary(path: Path) -> Iterator[tuple[int, StoredCamera]]:
    file = _Cursor(path)
    for _ in range(file.count(24 + 3 * 8, "cameras")):
        camera_id, number, width, height = file.take("IiQQ")
        if number not in MODELS:
            raise DatasetError(f"lens model number {number} is unknown", where=f"{path}, camera {camera_id}")
        name, count = MODELS[number]
        yield camera_id, StoredCamera(name, width, height, file.take(f"{count}d"))


def _images_binary(path: Path) -> Iterator[tuple[int, str, int, tuple[float, ...], NDArray[Any], NDArray[Any]]]:
    file = _Cursor(path)
    feature = np.dtype([("pixel", "<f8", 2), ("point", "<u8")])
    for _ in range(file.count(64 + 1 + 8, "images")):
        image_id, *placed, camera_id = file.take("I7dI")
        name = file.text()
        count = file.count(feature.itemsize, "features")
        features = np.frombuffer(file.data, feature, count, file.place)
        file.place += count * feature.itemsize
        yield image_id, name, camera_id, tuple(placed), features["pixel"].copy(), features["point"].copy()


POINT = np.dtype([("id", "<u8"), ("position", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("track", "<u8")])
"""A point as stored, without the sightings that follow it."""


def _points_binary(path: Path) -> tuple[NDArray[np.uint64], NDArray[np.float64], NDArray[np.uint8]]:
    file = _Cursor(path)
    count = file.count(51, "points")
    starts, length = np.zeros(count, np.int64), struct.Struct("<Q")
    for row in range(count):  # only lengths are read one by one
        starts[row] = file.place
        file.need(POINT.itemsize)
        file.place += POINT.itemsize - length.size
        file.place += length.size + 8 * file.room_for(8, length.unpack_from(file.data, file.place)[0], "sightings")
    records = np.frombuffer(file.data, np.uint8)[starts[:, None] + np.arange(POINT.itemsize)].view(POINT)[:, 0]
    return records["id"].copy(), _finite(records["position"].astype(np.float64), path), records["colour"].copy()


def _finite(points: NDArray[np.float64], path: Path) -> NDArray[np.float64]:
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points).all(1)).sum())
        raise DatasetError("points are not finite", where=path, why=f"{bad} of {len(points)}", remedy="drop them")
    return points


def _lines(path: Path, *, keep_empty: bool = False) -> Iterator[tuple[str, list[str]]]:
    """(where, words) of each line that is not a comment."""
    for number, line in enumerate(files.read_text(path, MAX_BYTES).splitlines(), 1):
        if not line.startswith("#") and (line.strip() or keep_empty):
            yield f"{path}, line {number}", line.split()


def _cameras_text(path: Path) -> Iterator[tuple[int, StoredCamera]]:
    counts = dict(MODELS.values())
    for where, words in _lines(path):
        try:
            camera_id, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (IndexError, ValueError, OverflowError) as error:
            raise DatasetError("line is not a camera", where=where, why=str(error)) from None
        if counts.get(model) != len(parameters):
            raise DatasetError(f"lens model {model[:40]} with {len(parameters)} parameters is unknown", where=where)
        yield camera_id, StoredCamera(model, width, height, parameters)


def _images_text(path: Path) -> Iterator[tuple[int, str, int, tuple[float, ...], NDArray[Any], NDArray[Any]]]:
    lines = _lines(path, keep_empty=True)
    for where, words in lines:
        if not words:
            continue
        try:
            image_id, camera_id = int(words[0]), int(words[8])
            placed, name = tuple(float(word) for word in words[1:8]), " ".join(words[9:])
            _, features = next(lines, ("", []))
            if len(features) % 3:
                raise ValueError
            pixels = np.array([features[0::3], features[1::3]], np.float64).T.reshape(-1, 2)
            points = np.array([int(word) % 2**64 for word in features[2::3]], np.uint64)  # -1 is `NOWHERE`
        except (IndexError, ValueError, OverflowError):
            raise DatasetError("lines are not an image and its features", where=where, remedy=PAIRS) from None
        if len(points) != len(pixels) or not name:
            why = f"{len(features)} words, name {name!r}"
            raise DatasetError("lines are not an image and its features", where=where, why=why, remedy=PAIRS)
        yield image_id, name, camera_id, placed, pixels, points


def _points_text(path: Path) -> tuple[NDArray[np.uint64], NDArray[np.float64], NDArray[np.uint8]]:
    ids, points, colours = [], [], []
    for where, words in _lines(path):
        try:
            ids.append(np.uint64(int(words[0])))
            points.append([float(word) for word in words[1:4]])
            colours.append([np.uint8(int(word)) for word in words[4:7]])
            complete = len(points[-1]) == 3 and len(colours[-1]) == 3
        except (IndexError, ValueError, OverflowError) as error:
            raise DatasetError("line is not a point", where=where, why=str(error)) from None
        if not complete:
            raise DatasetError("line is not a point", where=where, why=f"{len(words)} words")
    array = np.array(points, np.float64).reshape(-1, 3)
    return np.array(ids, np.uint64), _finite(array, path), np.array(colours, np.uint8).reshape(-1, 3)
