"""LLFF folders: `poses_bounds.npy` and images whose sorted names correspond to its rows.

A row is a 3x5 matrix in row-major order, near, and far. Its columns: the camera axes down, right, back; the position;
height, width and focal length of the full-size images, which may be missing.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import OPENCV_FROM_LLFF
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, export, sidecar
from koala3d.datasets.formats.finding import pictures
from koala3d.datasets.formats.links import Extra, copy_all, file_name, write_smaller
from koala3d.datasets.scene import Scene, View, with_test_views
from koala3d.datasets.structure import bounds

FILE = "poses_bounds.npy"
LAYOUT = export.Layout(
    "LLFF's layout", lambda camera: camera.is_centred, "lens distortion or an off-centre principal point", mask="masks/{stem}"
)


def detect(folder: Path) -> bool:
    """True for a folder with `poses_bounds.npy`."""
    return (folder / FILE).is_file()


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read an LLFF folder; every `hold_out`-th view by sorted name is a test view.

    There may be a mask of the object for each image (`finding.masks`).

    Raises:
        DatasetError: the number of rows or the aspect ratio does not match the images.
    """
    rows = read_rows(files.inside(folder, FILE))
    found, chosen = pictures.find(folder, images_folder)
    if len(found) != len(rows):
        why = f"it has {len(rows)} rows, {chosen} holds {len(found)} images"
        remedy = "put every image in place: sorted names correspond to rows"
        if len(found) > len(rows):
            remedy = (
                "remove the images without a row, for COLMAP found no pose for them (view_imgs.txt names those that have one)"
            )
        raise DatasetError("rows and images do not correspond", where=folder / FILE, why=why, remedy=remedy)
    gathering = assemble.Gathering(folder, problems)
    masks = gathering.masks(found[0].parent, [picture.name for picture in found])
    for number, (row, picture, mask) in enumerate(zip(rows, found, masks, strict=True)):
        with gathering.collecting():
            where = f"{folder / FILE}, row {number} ({picture.name})"
            matrix, camera = _posed(gathering, row, gathering.file(picture, where=where), where=where)
            gathering.views.append(View(picture.stem, camera, matrix, "train", picture, mask))
    views = gathering.finished(listed_in=chosen)
    if (folder / "sparse" / "0").is_dir() and not (folder / "sparse" / "0" / "images.bin").is_file():
        gathering.notes.append("sparse/0 has no images.bin: its COLMAP model is not used")
    if (known := sidecar.read(folder)) is not None:
        return sidecar.restore(known, views, folder, notes=tuple(gathering.notes))
    near_far = (rows[:, 15].min(), rows[:, 16].max())
    return assemble.scene(gathering, with_test_views(views, hold_out), "llff", near_far=near_far)


def read_rows(path: Path) -> NDArray[np.float64]:
    """(n, 17) rows of a poses_bounds.npy. Raises DatasetError for any other content; nothing is unpickled."""
    rows = arrays.numbers(arrays.read_npy(path), (None, 17), where=path)
    if len(rows) and not (0 <= rows[:, 15].min() < rows[:, 16].max() < np.inf):
        raise DatasetError("near and far are not in order", where=path, why=f"{rows[:, 15].min()} and {rows[:, 16].max()}")
    return rows


def save(scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore, sizes: tuple[int, ...] = ()) -> str:
    """Export a scene; arguments and result are those of `save_scene`. A row's near and far are the box's depth range."""
    with files.atomic_folder(path) as folder:
        placed = export.place_all(scene.views, folder, lambda view: f"images/{file_name(view)}", LAYOUT, done)
        ordered = sorted((p.view for p in placed), key=lambda view: view.image)
        rows = [row_of(v.world_from_camera, v.camera, *bounds.depth_range([v], scene.box)) for v in ordered]
        with files.atomic_path(folder / FILE) as temporary:
            np.save(temporary, np.stack(rows))
        copy_all(extra, folder)
        write_smaller(ordered, folder, sizes, lambda view, source: source.name)
        by_name = {view.image.stem: view for view in (p.view for p in placed)}
        sidecar.write(folder, scene, by_name)
    return export.limits(scene, placed, LAYOUT)


def row_of(world_from_camera: NDArray[np.float64], camera: Camera, near: float, far: float) -> NDArray[np.float64]:
    """(17,) row of a centred pinhole's pose in our axes."""
    matrix = np.concatenate([(world_from_camera @ OPENCV_FROM_LLFF)[:3], [[camera.height], [camera.width], [camera.fx]]], axis=1)
    return np.concatenate([matrix.ravel(), [near, far]])


def _posed(
    gathering: assemble.Gathering, row: NDArray[np.float64], picture: Path, *, where: str
) -> tuple[NDArray[np.float64], Camera]:
    """world_from_camera in our axes, and intrinsics scaled to the image."""
    matrix = row[:15].reshape(3, 5)
    if not np.isfinite(matrix[:, 4]).all() or not (matrix[:, 4] > 0).all():
        raise DatasetError("height, width and focal length are not positive", where=where, why=str(matrix[:, 4]))
    height, width, focal = (float(value) for value in matrix[:, 4])
    full = Camera(round(width), round(height), focal, focal, width / 2, height / 2)
    camera = gathering.fitted(full, picture, where=where)
    return pose.checked(pose.checked(matrix[:, :4], where=where) @ OPENCV_FROM_LLFF, where=where), camera
