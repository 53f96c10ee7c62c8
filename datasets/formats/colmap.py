"""COLMAP models, text or binary, through pycolmap (imported for files here alone).

Poses are camera_from_world in our axes and pixel convention already; the world is that of the model.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets import bounds, images, pose
from datasets.camera_model import Camera
from datasets.errors import DatasetError, KoalaError, Misuse
from datasets.formats import assemble
from datasets.formats.llff import PICTURES
from datasets.scene import Scene, View

MODELS = ("sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", "")
"""Where a model may lie below the scene."""
NEEDED = ("cameras", "images", "points3D")
PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"), "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"), "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}  # fmt: skip
"""Meaning of each lens model's numbers; the others do not fit our camera."""


def detect(folder: Path) -> bool:
    """True for a folder with a complete model in one of `MODELS`."""
    return any((folder / place / f"cameras{suffix}").is_file() for place in MODELS for suffix in (".bin", ".txt"))


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None,
         problems: list[KoalaError] | None = None) -> Scene:  # fmt: skip
    """Read a COLMAP scene; every `hold_out`-th view by sorted name is a test view.

    Raises:
        DatasetError: the model lacks a file or uses a lens model that Koala lacks.
    """
    place, model = _model(folder)
    home = _images(folder, place, images_folder)
    gathering = assemble.Gathering(folder, problems)
    for image in sorted(model.images.values(), key=lambda image: image.name):
        where = f"{place / 'images'}, {image.name}"
        picture = home / image.name
        try:
            if not picture.is_file():
                gathering.missing.append(image.name)
                continue
            camera = _camera(model.cameras[image.camera_id], where=where)
            size = images.size(picture)
            if size != (camera.width, camera.height):
                camera = camera.scaled(*size)
            matrix = pose.inverse(pose.checked(image.cam_from_world().matrix(), where=where))
            gathering.views.append(View(Path(image.name).with_suffix("").as_posix(), camera, matrix, "train", picture))
        except KoalaError as error:
            gathering.complain(error)
    views = assemble.hold_out(gathering.finished(listed_in=f"{place.name}/images"), hold_out)
    scene = assemble.scene(gathering, views, provenance={"format": "colmap", "source": str(folder.absolute())})
    points = np.array([point.xyz for point in model.points3D.values()], np.float64).reshape(-1, 3)
    return _with_points(scene, points) if len(points) else scene


def _with_points(scene: Scene, points: np.ndarray) -> Scene:
    """The scene with its sparse points, and box and near from them where no mask gave better ones."""
    found = bounds.about_points(scene.views, points)
    if scene.background == "white" or found is None:
        return replace(scene, points=points)
    return replace(scene, points=points, box=found[0], near=found[1], bounds_from=f"{len(points)} points of the model")


def _model(folder: Path) -> tuple[Path, Any]:
    """(folder of the model, pycolmap's reconstruction)."""
    places = [folder / place for place in MODELS if any((folder / place / f"cameras{end}").is_file() for end in (".bin", ".txt"))]
    if not places:
        raise Misuse("holds no COLMAP model", where=folder, why=f"no cameras.bin in {', '.join(filter(None, MODELS))}")
    place = places[0]
    suffix = ".bin" if (place / "cameras.bin").is_file() else ".txt"
    absent = [name + suffix for name in NEEDED if not (place / (name + suffix)).is_file()]
    if absent:
        raise DatasetError("COLMAP model is not complete", where=place, why=f"{', '.join(absent)} is missing",
                           remedy="copy the whole model")  # fmt: skip
    import pycolmap

    try:
        return place, pycolmap.Reconstruction(place)
    except (RuntimeError, ValueError, IndexError) as error:
        raise DatasetError("COLMAP model cannot be read", where=place, why=str(error)) from None


def _images(folder: Path, place: Path, wanted: str | None) -> Path:
    if wanted is not None:
        return folder / wanted
    candidates = [folder / "images", place.parent / "images", *sorted(folder.glob("images_*"))]
    for path in candidates:
        if path.is_dir() and any(p.suffix.lower() in PICTURES for p in path.iterdir()):
            return path
    raise DatasetError("scene has no images", where=folder / "images", remedy="put the images there")


def _camera(stored: Any, *, where: str) -> Camera:
    name = stored.model.name
    if name not in PARAMETERS:
        raise DatasetError(f"camera model {name} is not supported", where=where, remedy="undistort the images with COLMAP first")
    said = dict(zip(PARAMETERS[name], (float(v) for v in stored.params), strict=True))
    if "f" in said:
        said["fx"] = said["fy"] = said.pop("f")
    return Camera.from_json({"width": stored.width, "height": stored.height, **said}, where=where)
