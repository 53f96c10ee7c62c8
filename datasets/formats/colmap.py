"""COLMAP folders, also in the layout of mip-NeRF 360: a model, `images/` and, where there are several sizes, `images_N/`.

Poses are camera_from_world in our axes and pixel convention; the world is that of the model. `colmap_files` reads models,
`colmap_library` writes them.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError, UsageError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, colmap_library, export, llff, sidecar
from koala3d.datasets.formats.colmap_files import Model, StoredCamera, StoredImage, read_model
from koala3d.datasets.formats.finding import models
from koala3d.datasets.formats.finding.pictures import Listing, homes, photographs, without_suffix
from koala3d.datasets.formats.links import Extra, copy_all, file_name, write_smaller
from koala3d.datasets.scene import Scene, Sightings, View, with_test_views

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
    "SIMPLE_FISHEYE": ("f", "cx", "cy"),
    "FISHEYE": _FOCALS,
}
"""Parameters of the lens models that our camera can represent."""
LAYOUT = export.Layout("COLMAP's layout", lambda camera: camera.spline is None, "a splined lens", mask="masks/{file}")


def detect(folder: Path) -> bool:
    """True for a folder with the cameras of a model in one of `models.PLACES`."""
    return models.exists(folder)


def is_whole(folder: Path) -> bool:
    """True where the folder has a readable model and most of its images."""
    try:
        source = _find(folder, None)
        present = [source.image(image.name) is not None for image in source.model.images]
        return not source.renamed and sum(present) > len(present) / 2
    except KoalaError:
        return False


def load(
    folder: Path,
    *,
    hold_out: int = 8,
    images_folder: str | None = None,
    problems: list[KoalaError] | None = None,
    any_lens: bool = False,
) -> Scene:
    """Read a COLMAP scene; every `hold_out`-th view by sorted name is a test view. With `any_lens`, lenses that our camera cannot
    hold are accepted: the scene's images can be resampled, and nothing else.

    Raises:
        DatasetError: the model lacks a file or uses an unsupported lens model.
    """
    source = _find(folder, images_folder)
    model, listed_in = source.model, source.place / "images"
    gathering = assemble.Gathering(folder, problems, notes=list(source.notes))
    assemble.listed_once([image.name for image in model.images], where=listed_in)
    seen: dict[Path, tuple[StoredImage, np.ndarray]] = {}
    ordered = sorted(model.images, key=lambda image: image.name)
    present = {}
    for image in ordered:
        with gathering.collecting():
            gathering.file(source.home / image.name, where=f"{listed_in}, {image.name}")
            if (picture := source.image(image.name)) is not None:
                present[image.name] = picture
            else:
                gathering.missing.append(image.name)
    masks = dict(zip(present, gathering.masks(source.home, list(present)), strict=True))
    for image in (image for image in ordered if image.name in present):
        where, picture = f"{listed_in}, {image.name}", present[image.name]
        with gathering.collecting():
            full = _camera(model.cameras[image.camera_id], folder, any_lens=any_lens, where=where)
            camera = gathering.fitted(full, picture, where=where)
            matrix = pose.inverse(pose.checked(image.camera_from_world, where=where))
            name = without_suffix(PurePath(image.name))
            gathering.views.append(View(name, camera, matrix, "train", picture, masks[image.name]))
            seen[picture] = image, image.pixels * [camera.width / full.width, camera.height / full.height]
    if (folder / llff.FILE).is_file():
        gathering.notes.append(f"{llff.FILE} is not used: the COLMAP model in {source.place.relative_to(folder)} holds more")
    views = gathering.finished(listed_in=f"{source.place.name}/images")
    return _assembled(gathering, views, hold_out, _sightings(views, seen), model)


def _assembled(
    gathering: assemble.Gathering, views: tuple[View, ...], hold_out: int, sightings: Sightings | None, model: Model
) -> Scene:
    """The scene with the model's points, and with what a sidecar adds."""
    stored_facts = sidecar.read(gathering.folder)
    if stored_facts is not None:
        if sightings is not None:
            sightings = replace(sightings, names=tuple(sidecar.name_of(stored_facts, name) for name in sightings.names))
        scene = sidecar.restore(stored_facts, views, gathering.folder, notes=tuple(gathering.notes))
    else:
        scene = assemble.scene(gathering, with_test_views(views, hold_out), "colmap")
        scene = assemble.with_points(scene, model.points) if len(model.points) else scene
    return replace(scene, points=model.points, colours=model.colours, sightings=sightings) if len(model.points) else scene


def _sightings(views: tuple[View, ...], seen: dict[Path, tuple[StoredImage, np.ndarray]]) -> Sightings | None:
    """Which points the views saw, from the stored image of each picture and its features at the picture's size; None for none."""
    index, places = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2))]
    for number, view in enumerate(views):
        image, pixels = seen[view.image]
        matched = np.flatnonzero(image.points >= 0)
        index.append(np.stack([image.points[matched], np.full(len(matched), number)], axis=1))
        places.append(pixels[matched])
    found = np.concatenate(index)
    return Sightings(tuple(view.name for view in views), found, np.concatenate(places)) if len(found) else None


@dataclass(frozen=True, eq=False)
class _Source:
    """A model and where its images are."""

    place: Path
    model: Model
    home: Path
    notes: tuple[str, ...] = ()
    renamed: dict[str, Path] = field(default_factory=dict)
    """Image of each name of the model, where names do not tell."""
    listing: Listing = field(default_factory=Listing)

    def image(self, name: str) -> Path | None:
        """The image of this name in the model; its suffix may differ. None where there is none."""
        path = self.home / name
        return path if path.is_file() else self.renamed.get(name) or self.listing.like(self.home, name)


def _find(folder: Path, wanted: str | None) -> _Source:
    """The first model some of whose images exist, else the first with as many images as there are."""
    places, notes = models.find(folder)
    if not places:
        raise UsageError("holds no COLMAP model", where=folder, why="no cameras.bin in sparse/0, sparse or colmap/sparse/0")
    remaining, read = [], {}
    for place in places:
        cameras, images, points = (part and files.within(folder, part) for part in models.parts(place))
        read[place] = read_model(cameras, images, points)
        names = [image.name for image in read[place].images]
        for home in _homes(folder, place, wanted):
            source = _Source(place, read[place], home, tuple(notes[place] for _ in range(place in notes)))
            if any(source.image(name) for name in names if _is_inside(home, name)):
                return source
            remaining.append(source)
    having = [(source, found) for source in remaining if (found := photographs(source.listing.files(source.home)))]
    if not having:
        raise DatasetError("scene has no images", where=folder / (wanted or "images"), remedy="put the images there")
    same = [(source, found) for source, found in having if len(found) == len(source.model.images)]
    if not same:
        return having[0][0]
    source, found = same[0]
    said = f"images in {source.home.relative_to(folder)} have other names than in the model: they are taken in the order of names"
    renamed = dict(zip(sorted(image.name for image in source.model.images), found, strict=True))
    return replace(source, notes=(*source.notes, said), renamed=renamed)


def _homes(folder: Path, place: Path, wanted: str | None) -> list[Path]:
    """Folders that may hold the images of a model, those nearest to it first; names may begin with the folder's."""
    roots = [root for root in (place.parent, place.parent.parent, folder) if root == folder or folder in root.parents]
    if wanted is not None:
        files.inside(folder, wanted)
        return [root / wanted for root in dict.fromkeys(roots) if (root / wanted).is_dir()]
    return [home for root in dict.fromkeys(roots) if root.is_dir() for home in (*homes(root), root)]


def _is_inside(home: Path, name: str) -> bool:
    try:
        return bool(files.inside(home, name))
    except DatasetError:
        return False


def _camera(stored: StoredCamera, folder: Path, *, any_lens: bool, where: str) -> Camera:
    if stored.model in PARAMETERS:
        values: dict[str, Any] = dict(zip(PARAMETERS[stored.model], stored.parameters, strict=True))
        if "f" in values:
            values["fx"] = values["fy"] = values.pop("f")
        values["fisheye"] = "FISHEYE" in stored.model
        return Camera.from_json({"width": stored.width, "height": stored.height, **values}, where=where)
    if stored.model not in colmap_library.POINTWISE:
        raise DatasetError(f"camera model {stored.model} is not supported", where=where, remedy="cut perspective images from it")
    if not any_lens:
        raise assemble.foreign_lens(stored.model, folder, where=where)
    return colmap_library.camera(stored.model, (stored.width, stored.height), stored.parameters, where=where)


def save(
    scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore, sizes: tuple[int, ...] = (), text: bool = False
) -> str:
    """Export a scene with its points and sightings; arguments and result are those of `save_scene`.

    `sizes` of (2, 4, 8) give mip-NeRF 360's layout; with `text`, the model is written as text.
    """
    with files.atomic_folder(path) as folder:
        placed = export.place_all(scene.views, folder, lambda view: f"images/{file_name(view)}", LAYOUT, done)
        copy_all(extra, folder)
        write_smaller([p.view for p in placed], folder, sizes, lambda view, source: source.name)
        colmap_library.write_model(scene, [p.view for p in placed], folder / "sparse" / "0", text=text)
        sidecar.write(folder, scene, {p.view.image.stem: p.view for p in placed})
    return export.limits(scene, placed, LAYOUT)
