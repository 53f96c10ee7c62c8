"""COLMAP folders, also in the layout of mip-NeRF 360: a model, `images/` and, where there are several sizes, `images_N/`.

Poses are camera_from_world in our axes and pixel convention; the world is that of the model. `colmap_files` reads models;
pycolmap, imported only when a model is written, writes them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets import pose, splits
from datasets.camera_model import Camera
from datasets.core import files
from datasets.core.errors import DatasetError, KoalaError, UsageError
from datasets.core.progress import Step, ignore
from datasets.formats import assemble, export, llff, sidecar
from datasets.formats.colmap_files import Model, StoredCamera, StoredImage, read_model
from datasets.formats.links import Extra, file_name, link_all, write_smaller
from datasets.scene import Scene, Sightings, View

PLACES = ("sparse/0", "sparse", "colmap/sparse/0", "dense/sparse", "")
"""Where a scene may keep its model."""
NEEDED = ("cameras", "images", "points3D")
_FOCALS, _TANGENTIAL = ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")
PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": _FOCALS,
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": _FOCALS + _TANGENTIAL,
    "FULL_OPENCV": (*_FOCALS, *_TANGENTIAL, "k3", "k4", "k5", "k6"),
    "OPENCV_FISHEYE": (*_FOCALS, "k1", "k2", "k3", "k4"),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
}
"""Parameters of the lens models that our camera can represent."""
LAYOUT = export.Layout("COLMAP's layout", lambda camera: True, "", mask="masks/{file}")


def detect(folder: Path) -> bool:
    """True for a folder with the cameras of a model in one of `PLACES`."""
    return any((folder / place / f"cameras{suffix}").is_file() for place in PLACES for suffix in (".bin", ".txt"))


def is_whole(folder: Path) -> bool:
    """True where the folder has a readable model and most of its images."""
    try:
        place, home = _place(folder, None)
        names = [image.name for image in _model(folder, place).images]
        return sum(files.inside(home, name).is_file() for name in names) > len(names) / 2
    except KoalaError:
        return False


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read a COLMAP scene; every `hold_out`-th view by sorted name is a test view.

    Raises:
        DatasetError: the model lacks a file or uses an unsupported lens model.
    """
    place, home = _place(folder, images_folder)
    model = _model(folder, place)
    gathering = assemble.Gathering(folder, problems)
    assemble.listed_once([image.name for image in model.images], where=place / "images")
    pixels: dict[str, np.ndarray] = {}
    stored: dict[str, StoredImage] = {}
    for image in sorted(model.images, key=lambda image: image.name):
        where = f"{place / 'images'}, {image.name}"
        with gathering.collecting():
            picture = gathering.file(home / image.name, where=where)
            if not picture.is_file():
                gathering.missing.append(image.name)
                continue
            full = _camera(model.cameras[image.camera_id], where=where)
            camera = gathering.fitted(full, picture, where=where)
            matrix = pose.inverse(pose.checked(image.camera_from_world, where=where))
            mask = _mask(gathering, home, image.name, where=where)
            name = Path(image.name).with_suffix("").as_posix()
            gathering.views.append(View(name, camera, matrix, "train", picture, mask))
            stored[name] = image
            pixels[name] = image.pixels * [camera.width / full.width, camera.height / full.height]
    if (folder / llff.FILE).is_file():
        gathering.notes.append(f"{llff.FILE} is not used: the COLMAP model in {place.relative_to(folder)} holds more")
    views = gathering.finished(listed_in=f"{place.name}/images")
    sightings = _sightings(model, stored, pixels) if len(model.points) else None
    stored_facts = sidecar.read(folder)
    if stored_facts is not None:
        if sightings is not None:
            sightings = replace(sightings, names=tuple(sidecar.name_of(stored_facts, name) for name in sightings.names))
        scene = sidecar.restore(stored_facts, views, folder, notes=tuple(gathering.notes))
        return replace(scene, points=model.points, sightings=sightings) if sightings is not None else scene
    scene = assemble.scene(gathering, splits.hold_out(views, hold_out), "colmap")
    return replace(assemble.with_points(scene, model.points), sightings=sightings) if sightings is not None else scene


def _sightings(model: Model, stored: dict[str, StoredImage], pixels: dict[str, np.ndarray]) -> Sightings:
    index, places = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2))]
    for number, (name, image) in enumerate(stored.items()):
        matched = np.flatnonzero(image.points >= 0)
        index.append(np.stack([image.points[matched], np.full(len(matched), number)], axis=1))
        places.append(pixels[name][matched])
    return Sightings(tuple(stored), np.concatenate(index), np.concatenate(places), model.colours)


def _place(folder: Path, wanted: str | None) -> tuple[Path, Path]:
    """(folder of the model, folder of its images): the first model that has images."""
    places = [folder / place for place in PLACES if any((folder / place / f"cameras{end}").is_file() for end in (".bin", ".txt"))]
    if not places:
        raise UsageError("holds no COLMAP model", where=folder, why=f"no cameras.bin in {', '.join(filter(None, PLACES))}")
    if wanted is not None:
        return places[0], files.inside(folder, wanted)
    for place in places:
        for home in (folder / "images", place.parent / "images", *sorted(folder.glob("images_*"))):
            if home.is_dir() and any(p.suffix.lower() in llff.PICTURES for p in files.within(folder, home).rglob("*")):
                return place, home
    raise DatasetError("scene has no images", where=folder / "images", remedy="put the images there")


def _model(folder: Path, place: Path) -> Model:
    suffix = ".bin" if (place / "cameras.bin").is_file() else ".txt"
    absent = [name + suffix for name in NEEDED if not (place / (name + suffix)).is_file()]
    if absent:
        why = f"{', '.join(absent)} is missing"
        raise DatasetError("COLMAP model is not complete", where=place, why=why, remedy="copy the whole model")
    return read_model(*(files.within(folder, place / (name + suffix)) for name in NEEDED))


def _mask(gathering: assemble.Gathering, home: Path, name: str, *, where: str) -> Path | None:
    """Mask of an image: `masks/NAME.EXT.png`, as COLMAP has it, or `masks/NAME.png`."""
    folder = home.with_name(home.name.replace("images", "masks"))
    for candidate in (folder / f"{name}.png", (folder / name).with_suffix(".png")):
        if candidate.is_file() and folder != home:
            return gathering.file(candidate, where=where)
    return None


def _camera(stored: StoredCamera, *, where: str) -> Camera:
    if stored.model not in PARAMETERS:
        remedy = "undistort the images with COLMAP first"
        raise DatasetError(f"camera model {stored.model} is not supported", where=where, remedy=remedy)
    values: dict[str, Any] = dict(zip(PARAMETERS[stored.model], stored.parameters, strict=True))
    if "f" in values:
        values["fx"] = values["fy"] = values.pop("f")
    values["fisheye"] = "FISHEYE" in stored.model
    return Camera.from_json({"width": stored.width, "height": stored.height, **values}, where=where)


def save(
    scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore, sizes: tuple[int, ...] = (), text: bool = False
) -> str:
    """Export a scene with its points and sightings; arguments and result are those of `save_scene`.

    `sizes` of (2, 4, 8) give mip-NeRF 360's layout; with `text`, the model is written as text.
    """
    with files.atomic_folder(path) as folder:
        placed = export.place_all(scene.views, folder, lambda view: f"images/{file_name(view)}", LAYOUT, done)
        link_all(extra, folder)
        write_smaller([p.view for p in placed], folder, sizes, lambda view, source: source.name)
        _write_model(scene, [p.view for p in placed], folder / "sparse" / "0", text=text)
        sidecar.write(folder, scene, {p.view.image.stem: p.view for p in placed})
    return export.limits(scene, placed, LAYOUT)


def _write_model(scene: Scene, views: list[View], folder: Path, *, text: bool) -> None:
    """Write the three files of the model, and those of COLMAP 4, for views as exported."""
    import pycolmap

    model = pycolmap.Reconstruction()
    cameras = {camera: number for number, camera in enumerate(dict.fromkeys(view.camera for view in views), 1)}
    for camera, number in cameras.items():
        kind, values = _parameters(camera)
        stored = pycolmap.Camera(camera_id=number, model=kind, width=camera.width, height=camera.height, params=values)
        model.add_camera_with_trivial_rig(stored)
    features = _features(scene, views)
    for number, view in enumerate(views, 1):
        image = pycolmap.Image(view.image.name, features[number][1], cameras[view.camera], number)
        camera_from_world = pycolmap.Rigid3d(pose.inverse(view.world_from_camera)[:3])
        model.add_image_with_trivial_frame(image, camera_from_world)
    tracks: dict[int, list[tuple[int, int]]] = {}
    for number, (points, _) in features.items():
        for place, point in enumerate(points):
            tracks.setdefault(int(point), []).append((number, place))
    if scene.points is not None:
        colours = np.zeros((len(scene.points), 3), np.uint8) if scene.sightings is None else scene.sightings.colours
        for point, xyz in enumerate(scene.points):
            track = pycolmap.Track([pycolmap.TrackElement(*element) for element in tracks.get(point, [])])
            model.add_point3D(xyz, track, colours[point])
        model.update_point_3d_errors()
    folder.mkdir(parents=True)
    (model.write_text if text else model.write_binary)(folder)


def _features(scene: Scene, views: list[View]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Per image number, from 1: (k,) points that it saw and (k, 2) their pixels."""
    sightings = scene.sightings
    if sightings is None or scene.points is None:
        return {number: (np.zeros(0, np.int64), np.zeros((0, 2))) for number in range(1, len(views) + 1)}
    numbers = {name: index for index, name in enumerate(sightings.names)}
    found = {}
    for number, view in enumerate(views, 1):
        rows = np.flatnonzero(sightings.index[:, 1] == numbers.get(view.name, -1))
        found[number] = (sightings.index[rows, 0], sightings.pixels[rows])
    return found


def _parameters(camera: Camera) -> tuple[str, list[float]]:
    """The simplest lens model that represents a camera, and its parameters."""
    straight = [camera.fx, camera.fy, camera.cx, camera.cy]
    if camera.is_pinhole:
        return "PINHOLE", straight
    if camera.fisheye:
        return "OPENCV_FISHEYE", [*straight, camera.k1, camera.k2, camera.k3, camera.k4]
    bent, higher = [*straight, camera.k1, camera.k2, camera.p1, camera.p2], [camera.k3, camera.k4, camera.k5, camera.k6]
    return ("FULL_OPENCV", bent + higher) if any(higher) else ("OPENCV", bent)
