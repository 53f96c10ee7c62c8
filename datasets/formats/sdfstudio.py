"""SDFStudio folders, read only: one `meta_data.json` with a 4x4 matrix of intrinsics for each image and OpenCV camera axes.

The world is that of the file; `worldtogt` and `pairs` are not used, nor are the monocular depth and normals, which are estimates.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.formats import assemble, opengl
from koala3d.datasets.formats.finding.pictures import without_suffix
from koala3d.datasets.formats.finding.stated import Images, other_path
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View, with_test_views

FILE = "meta_data.json"
MASKS = ("foreground_mask", "mask_path")
"""Keys of a frame's mask."""


def detect(folder: Path) -> bool:
    """True for a folder with `meta_data.json`."""
    return (folder / FILE).is_file()


def load(folder: Path, *, hold_out: int = 8, images_folder: str | None = None, problems: list[KoalaError] | None = None) -> Scene:
    """Read an SDFStudio folder; every `hold_out`-th view by sorted name is a test view. The box is the file's if it has one.

    Raises:
        DatasetError: a frame lacks its intrinsics or its pose, or the lens is no pinhole.
    """
    source = folder / FILE
    content = files.read_json(files.within(folder, source))
    gathering = assemble.Gathering(folder, problems)
    listed = content.get("frames") if isinstance(content, dict) else None
    frames = [{**frame, "file_path": frame.get("rgb_path")} for frame in listed or () if isinstance(frame, dict)]
    frames = opengl.frames_of({"frames": frames}, where=source)
    present = Images(folder, frames, where=source, home=images_folder)
    gathering.notes += present.notes
    for frame in frames:
        where = f"{source}, {frame['file_path']}"
        with gathering.collecting():
            image = present.path(frame["file_path"], where=where)
            if image is None:
                gathering.missing.append(frame["file_path"])
                continue
            camera = gathering.fitted(_camera(content, frame, image, where=where), image, where=where)
            matrix = pose.checked(frame.get("camtoworld", ()), where=where)
            masks = (other_path(frame, key, folder, where=where) for key in MASKS)
            name = without_suffix(image.relative_to(folder))
            gathering.views.append(View(name, camera, matrix, "train", image, next(filter(None, masks), None)))
    scene = assemble.scene(gathering, with_test_views(gathering.finished(listed_in=FILE), hold_out), "sdfstudio")
    return _in_box(scene, content.get("scene_box"), where=source)


def _camera(content: dict[str, Any], frame: dict[str, Any], image: Path, *, where: str) -> Camera:
    model = str(content.get("camera_model") or "OPENCV").upper()
    if model not in opengl.PINHOLES:
        remedy = "undistort the images to a pinhole first"
        raise DatasetError(f"camera model {model} is not supported", where=where, remedy=remedy)
    given = np.asarray(frame.get("intrinsics"), np.float64)
    matrix = arrays.numbers(given[:3, :3] if given.ndim == 2 else given, (3, 3), where=f"{where}, intrinsics")
    size = (content["width"], content["height"]) if "width" in content and "height" in content else images.size(image)
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(int(size[0]), int(size[1]), fx, fy, cx, cy).checked(where=where)


def _in_box(scene: Scene, stated: Any, *, where: Path) -> Scene:
    """The scene with its box limited to the file's `aabb`; without masks the box and the near and far of the file are taken."""
    if not isinstance(stated, dict) or stated.get("aabb") is None:
        return scene
    box = arrays.numbers(np.asarray(stated["aabb"], np.float64), (2, 3), where=f"{where}, scene_box")
    if not (np.isfinite(box).all() and (box[0] < box[1]).all()):
        raise DatasetError("scene_box is empty or not finite", where=where, why=str(box.tolist()))
    if scene.background == "white":
        inner = np.stack([np.maximum(scene.box[0], box[0]), np.minimum(scene.box[1], box[1])])
        return replace(scene, box=inner) if (inner[0] < inner[1]).all() else scene
    near, far = float(stated.get("near", scene.near)), float(stated.get("far", scene.far))
    if not 0 <= near < far:
        raise DatasetError("near and far are not in order", where=where, why=f"near {near}, far {far}")
    return replace(scene, box=box, near=near, far=far, bounds_from="stated by the file")
