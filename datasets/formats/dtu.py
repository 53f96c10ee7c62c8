"""DTU in the layout of IDR and NeuS: `cameras_sphere.npz`, `image/`, `mask/`; the folders may have their other usual names.

`world_mat_i` is the projection K [R | t] of camera i for the original image size, in OpenCV's axes and pixel origin;
`scale_mat_i` takes the unit sphere about the object to the world. The world is that of the file (millimetres for DTU).
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import opencv_from_pixels, pixels_from_opencv
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, export, sidecar
from koala3d.datasets.formats.finding import pictures
from koala3d.datasets.formats.links import Extra, copy_all
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View, with_test_views
from koala3d.datasets.structure import bounds

CAMERAS = ("cameras_sphere.npz", "cameras.npz", "cameras_large.npz")
LAYOUT = export.Layout("DTU's layout", lambda camera: camera.is_pinhole, "lens distortion", mask="mask/{stem}")


def detect(folder: Path) -> bool:
    """True for a folder with one of `CAMERAS` and a folder of images."""
    return any((folder / name).is_file() for name in CAMERAS) and bool(pictures.homes(folder))


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read a DTU folder; every `hold_out`-th view by sorted name is a test view.

    The file does not state the image size of its matrices. It is taken as the current size times the power of two that puts
    the principal point nearest to the image centre, and named in the notes.

    Raises:
        DatasetError: a camera or a mask is missing, or the cameras are not plain arrays.
    """
    source = next((folder / name for name in CAMERAS if (folder / name).is_file()), folder / CAMERAS[0])
    stored = _arrays(files.within(folder, source))
    found, home = pictures.find(folder, images_folder)
    numbers = _numbers(found, stored, where=source)
    gathering = assemble.Gathering(folder, problems)
    masks = gathering.masks(found[0].parent, [picture.name for picture in found])
    for index, picture, mask in zip(numbers, found, masks, strict=True):
        where = f"{source}, world_mat_{index} ({picture.name})"
        with gathering.collecting():
            if f"world_mat_{index}" not in stored:
                raise DatasetError("camera is missing", where=where, remedy="one world_mat for each image, in the order of names")
            size = images.size(gathering.file(picture, where=where))
            matrix, camera, factor = _posed(stored[f"world_mat_{index}"], size, where=where)
            gathering.views.append(View(picture.stem, camera, matrix, "train", picture, mask))
            if factor != 1:
                gathering.rescaled.append(
                    f"{camera.width * factor:g}x{camera.height * factor:g} for an image of {camera.width}x{camera.height}"
                )
    views = gathering.finished(listed_in=home)
    if (known := sidecar.read(folder)) is not None:
        return sidecar.restore(known, views, folder, notes=tuple(gathering.notes))
    scene = assemble.scene(gathering, with_test_views(views, hold_out), "dtu")
    return _in_sphere(scene, stored["scale_mat_0"]) if "scale_mat_0" in stored else scene


def save(scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore) -> str:
    """Export a scene; arguments and result are those of `save_scene`. The sphere of `scale_mat` encloses the box."""
    with files.atomic_folder(path) as folder:
        placed = []
        for number, view in enumerate(scene.views):
            placed.append(export.place(view, folder, f"image/{number:06d}", LAYOUT))
            done()
        centre, radius = scene.box.mean(0), float(np.linalg.norm(scene.box[1] - scene.box[0])) / 2
        scale = pose.rigid(radius * np.eye(3), centre)
        matrices = {f"world_mat_{number}": _projection(p.view) for number, p in enumerate(placed)}
        matrices |= {f"scale_mat_{number}": scale for number in range(len(placed))}
        with files.atomic_path(folder / CAMERAS[0]) as temporary:
            np.savez(temporary, allow_pickle=False, **matrices)
        copy_all(extra, folder)
        sidecar.write(folder, scene, {p.view.image.stem: p.view for p in placed})
    return export.limits(scene, placed, LAYOUT)


def _projection(view: View) -> NDArray[np.float64]:
    """(4, 4) K [R | t], with OpenCV's pixel origin."""
    intrinsics = np.eye(4)
    intrinsics[:3, :3] = view.camera.matrix
    intrinsics[:2, 2] = opencv_from_pixels(intrinsics[:2, 2])
    return intrinsics @ pose.inverse(view.world_from_camera)


def _in_sphere(scene: Scene, scale_mat: NDArray[np.float64]) -> Scene:
    """The scene with its box limited to the cube about the unit sphere, and near and far too where the background is empty."""
    centre, radius = scale_mat[:3, 3], float(scale_mat[0, 0])
    cube = np.stack([centre - radius, centre + radius])
    box = np.stack([np.maximum(scene.box[0], cube[0]), np.minimum(scene.box[1], cube[1])])
    box = box if scene.background == "white" and (box[0] < box[1]).all() else cube
    near, far = bounds.depth_range(scene.views, box)
    if scene.background == "white":
        return replace(scene, box=box, near=max(near, scene.near), far=min(far, scene.far))
    return replace(scene, box=box, near=min(near, scene.near), bounds_from="unit sphere of the file")


def _arrays(path: Path) -> dict[str, NDArray[np.float64]]:
    stored = arrays.read_npz(path, ("world_mat_", "scale_mat_"))
    return {name: arrays.numbers(array, (4, 4), where=f"{path}, {name}") for name, array in stored.items() if "inv" not in name}


def _numbers(found: list[Path], stored: dict[str, NDArray[np.float64]], *, where: Path) -> list[int]:
    """Number of each image's camera: its place among the sorted names, or the number in its name where images are left out."""
    cameras = sum(name.startswith("world_mat_") for name in stored)
    if cameras <= len(found):
        return list(range(len(found)))
    numbers = [int(digits[-1][-9:]) if (digits := re.findall(r"\d+", picture.stem)) else -1 for picture in found]
    if len(set(numbers)) < len(numbers) or not all(f"world_mat_{number}" in stored for number in numbers):
        why = f"{cameras} cameras, {len(found)} images whose names do not say which is which"
        remedy = "put every image in place: sorted names correspond to cameras"
        raise DatasetError("cameras and images do not correspond", where=where, why=why, remedy=remedy)
    return numbers


def _posed(world_mat: NDArray[np.float64], size: tuple[int, int], *, where: str) -> tuple[NDArray[np.float64], Camera, float]:
    """world_from_camera, intrinsics at the image's `size`, and the factor by which the image of the matrix is larger."""
    from scipy.linalg import rq

    if world_mat.shape != (4, 4) or not np.isfinite(world_mat).all():
        raise DatasetError("projection is not a finite 4x4 matrix", where=where)
    intrinsics, rotation = rq(world_mat[:3, :3])
    signs = np.diag(np.sign(np.diag(intrinsics)))
    intrinsics, rotation = intrinsics @ signs, signs @ rotation
    if np.linalg.det(rotation) < 0:  # the projection is known up to its sign
        rotation, world_mat = -rotation, -world_mat
    translation = np.linalg.solve(intrinsics, world_mat[:3, 3])
    intrinsics = intrinsics / intrinsics[2, 2]
    if abs(intrinsics[0, 1]) > 1e-3 * intrinsics[0, 0]:
        raise DatasetError("pixels are skewed", where=where, why=f"skew {intrinsics[0, 1]:.3g}")
    cx, cy = (float(value) for value in pixels_from_opencv(intrinsics[:2, 2]))
    width, height = size
    factor = float(2.0 ** np.round(np.log2(2 * max(cx, 1.0) / width)))
    full = Camera(round(width * factor), round(height * factor), float(intrinsics[0, 0]), float(intrinsics[1, 1]), cx, cy)
    camera_from_world = pose.checked(pose.rigid(rotation, translation), where=where)
    return pose.inverse(camera_from_world), full.scaled(width, height).checked(where=where), factor
