"""Scenes of the BOP benchmark (object pose estimation), read only: `scene_camera.json` beside `rgb` or `gray`.

Poses take the world (`cam_R_w2c`, `cam_t_w2c`) or an object's model (`cam_R_m2c`, `cam_t_m2c` of `scene_gt.json`) to the camera,
in our axes and in millimetres; matrices are stored row by row. The camera matrix `cam_K` is OpenCV's, with pixel centres at
integers, and may differ from image to image. Where no world is stated, the object that most images show once is the world.
"""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_PIXEL_SHIFT
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats import assemble
from koala3d.datasets.formats.finding.pictures import Listing
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View, with_test_views

CAMERAS, OBJECTS = "scene_camera.json", "scene_gt.json"
HOMES, MASKS = ("rgb", "gray"), ("mask_visib", "mask")
"""Folders of images, and of masks of what is visible of an object or of its whole outline."""
METRES = 1e-3
"""Per unit of a translation."""


def detect(folder: Path) -> bool:
    """True for a folder with `scene_camera.json`."""
    return (folder / CAMERAS).is_file()


@dataclass(frozen=True)
class _Chosen:
    """What is the world."""

    prefix: str
    """Of the keys of a pose: "w2c" or "m2c"."""
    of_image: dict[str, dict[str, Any]]
    """Entry with the pose of each image that has one, by the image's key."""
    masked: dict[str, int]
    """Number of the annotation whose mask belongs to an image."""
    notes: tuple[str, ...]


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read a BOP scene in metres; every `hold_out`-th view by sorted name is a test view.

    Raises:
        DatasetError: there is no pose of the cameras, or a file is not as described.
    """
    source = folder / CAMERAS
    entries = _entries(files.read_json(files.within(folder, source)), source)
    gathering = assemble.Gathering(folder, problems)
    chosen, home, listing = _chosen(folder, entries), _home(folder, images_folder), Listing()
    gathering.notes += chosen.notes
    for key in sorted(entries, key=int):
        where = f"{source}, {key}"
        with gathering.collecting():
            image = listing.like(home, f"{int(key):06d}")
            if image is None:
                gathering.missing.append(key)
                continue
            if key not in chosen.of_image:
                continue
            camera = gathering.fitted(_camera(entries[key], image, where), image, where=where)
            matrix = _pose(chosen.of_image[key], chosen.prefix, where)
            mask = _mask(folder, listing, int(key), chosen.masked.get(key))
            gathering.views.append(View(image.stem, camera, pose.inverse(matrix), "train", image, mask))
    views = gathering.finished(listed_in=CAMERAS)
    scene = assemble.scene(gathering, with_test_views(views, hold_out), "bop")
    return replace(scene, metric=True)


def _entries(content: Any, source: Path) -> dict[str, Any]:
    """What a file says of each image, by its number. Raises DatasetError where it is something else."""
    if not isinstance(content, dict) or not content or not all(key.isdigit() for key in content):
        raise DatasetError("is not made of numbers of images", where=source, remedy="give a scene of a BOP dataset")
    return content


def _home(folder: Path, wanted: str | None) -> Path:
    """The folder of the images. Raises DatasetError where there is none."""
    names = [wanted] if wanted is not None else HOMES
    found = next((files.inside(folder, name) for name in names if files.inside(folder, name).is_dir()), None)
    if found is None:
        raise DatasetError("scene has no images", where=folder, why=f"no folder {' or '.join(names)}")
    return found


def _chosen(folder: Path, entries: dict[str, Any]) -> _Chosen:
    """The world that the file states, else that of an object. Raises DatasetError where there is neither."""
    annotated = _entries(files.read_json(folder / OBJECTS), folder / OBJECTS) if (folder / OBJECTS).is_file() else {}
    single = {key: 0 for key, found in annotated.items() if isinstance(found, list) and len(found) == 1}
    stated = {key: entry for key, entry in entries.items() if isinstance(entry, dict) and "cam_R_w2c" in entry}
    if len(stated) == len(entries):
        several = () if len(single) == len(annotated) else ("masks are of several objects and are not used",)
        return _Chosen("w2c", stated, single if not several else {}, several)
    shown = {key: Counter(one["obj_id"] for one in found) for key, found in annotated.items()}
    once = Counter(name for counts in shown.values() for name, count in counts.items() if count == 1)
    if not once:
        remedy = f"give {OBJECTS} with one object that most images show once"
        raise DatasetError("poses of the cameras are not stated", where=folder / CAMERAS, why="no cam_R_w2c", remedy=remedy)
    name = max(once, key=lambda one: (once[one], -int(one)))
    index = {
        key: next(k for k, one in enumerate(annotated[key]) if one["obj_id"] == name)
        for key in entries.keys() & shown.keys()
        if shown[key][name] == 1
    }
    notes = [f"the world is the model of object {name}, which stands still in it; what else moves is not at rest"]
    if absent := len(entries.keys() - index.keys()):
        notes.append(f"{absent} of {len(entries)} images do not show object {name} once and are left out")
    return _Chosen("m2c", {key: annotated[key][k] for key, k in index.items()}, index, tuple(notes))


def _camera(entry: dict[str, Any], image: Path, where: str) -> Camera:
    matrix = _numbers(entry, "cam_K", 9, where).reshape(3, 3)
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise DatasetError("pixels are not rectangular", where=where, why=f"cam_K has a skew of {matrix[0, 1]:g}")
    shift, (width, height) = OPENCV_PIXEL_SHIFT, images.size(image)
    return Camera(width, height, matrix[0, 0], matrix[1, 1], matrix[0, 2] + shift, matrix[1, 2] + shift).checked(where=where)


def _pose(entry: dict[str, Any], prefix: str, where: str) -> NDArray[np.float64]:
    """(4, 4) camera_from_world [m]."""
    rotation = _numbers(entry, f"cam_R_{prefix}", 9, where).reshape(3, 3)
    return pose.checked(pose.rigid(rotation, METRES * _numbers(entry, f"cam_t_{prefix}", 3, where)), where=where)


def _numbers(entry: dict[str, Any], key: str, count: int, where: str) -> NDArray[np.float64]:
    """(count,) finite numbers of an entry. Raises DatasetError for anything else."""
    try:
        found = np.asarray(entry[key], np.float64).reshape(-1)
    except (KeyError, TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise DatasetError(f"{key} is not {count} numbers", where=where)
    return found


def _mask(folder: Path, listing: Listing, image: int, annotation: int | None) -> Path | None:
    """The mask of an annotation of an image, of what is visible if there is one."""
    if annotation is None:
        return None
    found = (listing.like(folder / home, f"{image:06d}_{annotation:06d}") for home in MASKS)
    return next((path for path in found if path is not None), None)
