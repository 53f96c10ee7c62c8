"""A person's corrections: dots and lines of a brush in pictures, each of the object or of what is not the object."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, UsageError, nearest
from koala3d.datasets.core.schema import Schema, validate

KIND, VERSION = "strokes", 1


class Stroke(Schema):
    """One stroke of the brush."""

    view: str
    """Name of the view."""
    of: Literal["object", "background"]
    """What the stroke lies on."""
    points: list[tuple[float, float]] = Field(min_length=1)
    """Pixels of the view's picture along the stroke, (x right, y down); one point is a dot."""
    radius: float = Field(gt=0)
    """Of the brush [px of the view's picture]."""

    def painted(self, camera: Camera, size: tuple[int, int]) -> NDArray[np.bool_]:
        """(height, width) pixels under the brush in a small picture of `size`; `camera` is that of the whole one."""
        height, width = size
        scale = np.array([width / camera.width, height / camera.height])
        line = np.round(np.asarray(self.points) * scale - 0.5).astype(np.int32)
        canvas = np.zeros((height, width), np.uint8)
        brush = max(self.radius * float(scale.mean()), 0.5)
        cv2.polylines(canvas, [line[:, None]], False, 1, max(round(2 * brush), 1))
        for x, y in line.tolist():
            cv2.circle(canvas, (x, y), round(brush), 1, -1)
        return canvas > 0


def read(path: Path, names: Iterable[str]) -> list[Stroke]:
    """The strokes of a file, which are in views called `names`.

    Raises:
        DatasetError: the file is not one of strokes.
        UsageError: a stroke is not complete, or in a view that there is not.
    """
    content = files.read_json(path, kind=KIND, version=VERSION)
    listed = content.get("strokes")
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        raise DatasetError("has no list 'strokes' of objects", where=path)
    found = [validate(one, Stroke, where=f"{path}: strokes[{i}]") for i, one in enumerate(listed)]
    known = set(names)
    for stroke in found:
        if stroke.view not in known:
            raise UsageError(f"no view called {stroke.view!r}", where=path, remedy=nearest(stroke.view, sorted(known)))
    return found


def write(path: Path, strokes: Sequence[Stroke]) -> None:
    """Write strokes, replacing the file at once."""
    files.write_json(path, {"format": KIND, "version": VERSION, "strokes": [stroke.model_dump() for stroke in strokes]})
