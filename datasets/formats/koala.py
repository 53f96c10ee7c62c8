"""Koala's own format: a complete scene in one folder, written atomically.

SCENE/cameras.json   version, bounds, background, and for each view its camera, pose, split and files
SCENE/images/        as captured, never re-encoded (hard links to files of Koala, copies of others)
SCENE/images_N/      the same at 1/N of the size, on request
SCENE/masks/         where there are masks, with masks_N
SCENE/ignored/       where pixels take no part: their masks, black is ignored
SCENE/deviations/    standard deviations of images that are merged from several exposures
SCENE/points.npz     where surface points are known: points, their colours, and the pixels of the views that saw them
SCENE/truth/         where there is ground truth: truth/<channel>/<view>.<suffix>, read by evaluation only
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, sidecar
from koala3d.datasets.formats.links import Extra, file_name, link, write_smaller
from koala3d.datasets.scene import DISPARITY, SPLITS, Scene, Sightings, View, checked_name

FILE = "cameras.json"
FORMAT, VERSION = "koala-scene", 1
POINTS = "points.npz"


def detect(folder: Path) -> bool:
    """True for a folder with Koala's `cameras.json`; 3D Gaussian Splatting writes another beside its models."""
    path = folder / FILE
    if not path.is_file():
        return False
    with open(path, "rb") as file:
        return not file.read(64).lstrip().startswith(b"[")


def save(scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore, sizes: tuple[int, ...] = ()) -> str:
    """Write a scene folder, images included; arguments and result are those of `formats.save_scene`."""
    with files.atomic_folder(path) as folder:
        views = []
        for view in scene.views:
            views.append(_saved_view(view, folder))
            done()
        for name, source in (extra or {}).items():
            link(source, folder, name)
        write_smaller(scene.views, folder, sizes, lambda view, source: f"{file_name(view)}{source.suffix}")
        if scene.points is not None:
            _save_points(scene, folder / POINTS)
        files.write_json(folder / FILE, {"format": FORMAT, "version": VERSION, **sidecar.facts(scene), "views": views})
    return ""


def _save_points(scene: Scene, path: Path) -> None:
    arrays = {"points": np.asarray(scene.points)}
    if scene.colours is not None:
        arrays["colours"] = scene.colours
    if (seen := scene.sightings) is not None:
        arrays |= {"names": np.array(seen.names, np.str_), "index": seen.index, "pixels": seen.pixels}
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _with_points(scene: Scene, path: Path) -> Scene:
    """The scene with the points of a file, and what it holds about them."""
    stored = arrays.read_npz(path)
    if "points" not in stored:
        raise DatasetError("holds no points", where=path)
    points = arrays.numbers(stored["points"], (None, 3), where=f"{path}, points")
    if not np.isfinite(points).all():
        raise DatasetError("points are not finite", where=path)
    colours = None
    if "colours" in stored:
        colours = arrays.numbers(stored["colours"], (len(points), 3), where=f"{path}, colours").astype(np.uint8)
    scene = replace(scene, points=points, colours=colours)
    if "index" not in stored:
        return scene
    try:
        index = arrays.numbers(stored["index"], (None, 2), where=f"{path}, index").astype(np.int64)
        pixels = arrays.numbers(stored["pixels"], (len(index), 2), where=f"{path}, pixels")
        names = tuple(str(name) for name in stored["names"])
    except KeyError as error:
        raise DatasetError("sightings are not complete", where=path, why=str(error)) from None
    if len(index) and not ((index >= 0).all() and (index < [len(points), len(names)]).all()):
        raise DatasetError("sightings refer to missing points or views", where=path)
    return replace(scene, sightings=Sightings(names, index, pixels))


def _saved_view(view: View, folder: Path) -> dict[str, Any]:
    name = file_name(view)

    def keep(source: Path, below: str) -> str:
        disparity = DISPARITY if source.stem.endswith(DISPARITY) else ""  # its name states its encoding
        return link(source, folder, f"{below}/{name}{disparity}{source.suffix}").relative_to(folder).as_posix()

    return {
        "name": view.name,
        "split": view.split,
        "image": keep(view.image, "images"),
        "mask": keep(view.mask, "masks") if view.mask else None,
        "ignored": keep(view.ignored, "ignored") if view.ignored else None,
        "deviation": keep(view.deviation, "deviations") if view.deviation else None,
        "white": view.white,
        "truth": {key: keep(source, f"truth/{key}") for key, source in view.truth.items()},
        "depth_unit": view.depth_unit,
        "camera": view.camera.to_json(),
        "world_from_camera": view.world_from_camera.tolist(),
        **sidecar.placed(view),
    }


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read a scene folder. Splits are stated, so `hold_out` is ignored; `images_folder` reads the images of `images_N` instead.

    Raises:
        DatasetError: a view or a bound is missing, damaged or impossible.
    """
    source = folder / FILE
    content = files.read_json(files.inside(folder, FILE), kind=FORMAT, version=VERSION)
    gathering = assemble.Gathering(folder, problems)
    views = content.get("views")
    if not isinstance(views, list):
        raise DatasetError("holds no list of views", where=source)
    assemble.listed_once([entry["name"] for entry in views if isinstance(entry, dict) and "name" in entry], where=source)
    for index, entry in enumerate(views):
        with gathering.collecting():
            gathering.views.append(_loaded_view(entry, folder, where=f"{source}, view {index}"))
    scene = sidecar.scene_of(content, gathering.finished(listed_in=FILE), where=source)
    if images_folder is not None:
        scene = scene.with_views(tuple(_resized(view, folder, images_folder) for view in scene.views))
    if not (folder / POINTS).is_file():
        return scene
    return _with_points(scene, files.inside(folder, POINTS))


def _resized(view: View, folder: Path, home: str) -> View:
    """The view with its image from another folder and intrinsics scaled to it."""
    where = f"{folder / FILE}, {view.name}"
    picture = files.within(folder, files.inside(folder, home) / view.image.name, where=where)
    mask = None
    if view.mask is not None:
        scaled = files.inside(folder, f"{home.replace('images', 'masks')}/{view.mask.name}", where=where)
        mask = scaled if scaled.is_file() else view.mask
    return replace(view, image=picture, mask=mask, deviation=None, camera=assemble.fitted(view.camera, picture, where=where))


def _loaded_view(entry: Any, folder: Path, *, where: str) -> View:
    try:
        name, split = checked_name(entry["name"], where=where), entry["split"]
        where = f"{where} ({name})"
        image, mask, unit = entry["image"], entry.get("mask"), sidecar.unit_of(entry, 1e-3)
        deviation, white, ignored = entry.get("deviation"), entry.get("white"), entry.get("ignored")
        if white is not None and not 0 < float(white) < np.inf:
            raise ValueError(f"white is {white!r}")
        truth = sidecar.truth_of(entry.get("truth", {}), folder, where=where)
        camera = Camera.from_json(entry["camera"], where=f"{where}, camera")
        matrix = pose.checked(entry["world_from_camera"], where=f"{where}, world_from_camera")
        placed = sidecar.place_of(entry, where=where)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError("view is not complete", where=where, why=f"{type(error).__name__} {error}") from None
    if split not in SPLITS:
        raise DatasetError(f"no split called {split!r}", where=where, remedy=f"valid: {', '.join(SPLITS)}")
    paths = (files.inside(folder, one, where=where) if one else None for one in (mask, deviation, ignored))
    mask, deviation, ignored = paths
    picture, white = files.inside(folder, image, where=where), white and float(white)
    beside: dict[str, Any] = {"ignored": ignored, "deviation": deviation, "white": white, "base_from_world": placed}
    return View(name, camera, matrix, split, picture, mask, truth, unit, **beside)
