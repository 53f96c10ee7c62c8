"""Camera export of RealityScan and RealityCapture ("Internal/External camera parameters", CSV), read only.

A row for each image: position; heading, pitch and roll [deg]; focal length for a picture of 36 mm on its longer side; principal
point as an offset from the middle, in units of the longer side; Brown's k1 to k4, t1, t2. Orientation is rot_z(-heading)
rot_x(pitch) rot_y(roll) with OpenGL's camera axes, as nerfstudio's importer has it; t1 and t2 are exchanged against OpenCV's p1
and p2, as AliceVision's importer of the same coefficients has it. The file does not say which lens model they belong to: Brown's
is the program's own choice.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_OPENGL
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats import assemble, opengl
from koala3d.datasets.formats.captures import shared
from koala3d.datasets.formats.finding.pictures import Listing, without_suffix
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View, with_test_views

REQUIRED = ("name", "x", "y", "alt", "heading", "pitch", "roll", "f")
OPTIONAL = ("px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
"""Columns; a template may leave out those that are optional, and they are zero then."""
FILM_MM = 36.0
LARGEST, HEAD = 2**26, 4096
"""Largest size of a file, and how much of it tells whether it is one [bytes]."""
MODEL = "coefficients are read as Brown's, which RealityScan chooses by itself; the file does not name another model"


def find(folder: Path) -> Path | None:
    """The camera export in a folder, the first by name; None where there is none."""
    return next((path for path in sorted(folder.glob("*.csv")) if path.is_file() and _header(_head(path)) is not None), None)


def _head(path: Path) -> list[str]:
    try:
        with open(path, "rb") as file:
            return file.read(HEAD).decode("utf-8-sig", errors="replace").splitlines()
    except OSError:
        return []


def _header(lines: list[str]) -> int | None:
    """Which of the first lines is the header; a line with the number of cameras may be in front of it."""
    return next((k for k, line in enumerate(lines[:3]) if set(REQUIRED) <= set(_columns(line))), None)


def _columns(line: str) -> list[str]:
    return [word.strip().lstrip("#").strip().lower() for word in line.split(",")]


def detect(folder: Path) -> bool:
    """True for a folder with a camera export of RealityScan or RealityCapture."""
    return find(folder) is not None


def load(
    folder: Path,
    *,
    hold_out: int = 8,
    images_folder: str | None = None,
    problems: list[KoalaError] | None = None,
    any_lens: bool = False,
) -> Scene:
    """Read a camera export; every `hold_out`-th view by sorted name is a test view. `any_lens` as in `opengl.camera`.

    Raises:
        DatasetError: a row is damaged, or uses a lens that `Camera` cannot hold.
    """
    source = find(folder)
    if source is None:
        raise DatasetError("holds no camera export of RealityScan", where=folder)
    gathering = assemble.Gathering(folder, problems)
    rows, listing, among = _rows(source), Listing(), shared.places(folder, images_folder)
    assemble.listed_once([row["name"] for row in rows], where=source)
    for row in rows:
        where = f"{source}, {row['name']}"
        with gathering.collecting():
            image = shared.image(listing, among, row["name"])
            if image is None:
                gathering.missing.append(row["name"])
                continue
            camera = gathering.fitted(_camera(row, image, folder, where, any_lens), image, where=where)
            name = without_suffix(image.relative_to(folder))
            gathering.views.append(View(name, camera, _pose(row), "train", image))
    shared.with_masks(gathering)
    views, notes = shared.near_the_origin(gathering.finished(listed_in=source.name))
    gathering.notes += notes
    if any(not view.camera.is_pinhole for view in views):
        gathering.notes.append(MODEL)
    return assemble.scene(gathering, with_test_views(views, hold_out), "realityscan")


def _rows(source: Path) -> list[dict[str, Any]]:
    """The rows, with numbers where numbers belong. Raises DatasetError for a row that lacks some."""
    lines = files.read_text(source, LARGEST, suffixes=(".csv",)).splitlines()
    first = _header(lines)
    assert first is not None, "the file was found by its header"
    names, rows = _columns(lines[first]), []
    for number, words in enumerate(csv.reader(lines[first + 1 :]), first + 2):
        if not any(word.strip() for word in words):
            continue
        found = dict(zip(names, words, strict=False))
        try:
            values = {key: float(found[key]) for key in REQUIRED[1:]} | {key: float(found.get(key) or 0) for key in OPTIONAL}
        except (KeyError, ValueError) as error:
            raise DatasetError("row is not complete", where=f"{source}, line {number}", why=str(error)) from None
        if not np.isfinite(list(values.values())).all():
            raise DatasetError("number is not finite", where=f"{source}, line {number}")
        rows.append({"name": found["name"].strip(), **values})
    return rows


def _pose(row: dict[str, Any]) -> np.ndarray:
    """(4, 4) world_from_camera."""
    turn = Rotation.from_euler("ZXY", [-row["heading"], row["pitch"], row["roll"]], degrees=True).as_matrix()
    return pose.rigid(turn, [row["x"], row["y"], row["alt"]]) @ OPENCV_FROM_OPENGL


def _camera(row: dict[str, Any], image: Path, folder: Path, where: str, any_lens: bool) -> Camera:
    width, height = images.size(image)
    side = max(width, height)
    focal, middle = row["f"] * side / FILM_MM, (width / 2 + row["px"] * side, height / 2 + row["py"] * side)
    bent = {"k1": row["k1"], "k2": row["k2"], "k3": row["k3"], "p1": row["t2"], "p2": row["t1"]}
    camera = Camera(width, height, focal, focal, *middle, **bent).checked(where=where)
    if not row["k4"]:
        return camera
    if not any_lens:
        raise assemble.foreign_lens(f"with k4 = {row['k4']:g} as the fourth radial coefficient", folder, where=where)
    return opengl.PolynomialCamera.of(camera, row["k4"])
