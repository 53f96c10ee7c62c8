"""Blender / NeRF-synthetic folders: `transforms_{train,val,test}.json`, RGBA images, OpenGL camera axes.

`camera_angle_x` is the horizontal field of view; the principal point is the centre. Shiny Blender's `_normal.png`,
`_disp.tiff` and `_alpha.png` beside an image are its truth. `koala.json` in the folder adds what this format cannot hold.
"""

from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, export, opengl, sidecar
from koala3d.datasets.formats.finding.pictures import without_suffix
from koala3d.datasets.formats.finding.stated import Images, other_path
from koala3d.datasets.formats.links import Extra, copy_all, file_name
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import DISPARITY, SPLITS, Scene, View, with_test_views

TRUTH = {"normals": ("_normal.png",), "alpha": ("_alpha.png",), "depth": (f"{DISPARITY}.tiff", f"{DISPARITY}.tif")}
"""Name suffixes of the truth maps; the first of each is written."""
LAYOUT = export.Layout("Blender's layout", lambda camera: camera.is_centred, "lens distortion or an off-centre principal point")


def detect(folder: Path) -> bool:
    """True for a folder with `transforms_train.json`."""
    return (folder / "transforms_train.json").is_file()


def load(
    folder: Path,
    *,
    hold_out: int = 8,
    images_folder: str | None = None,
    problems: list[KoalaError] | None = None,
    any_lens: bool = False,
) -> Scene:
    """Read a Blender folder. Without a test file, every `hold_out`-th training view is a test view.

    `any_lens` is that of `opengl.camera`.
    """
    gathering = assemble.Gathering(folder, problems)
    present = [split for split in SPLITS if (folder / f"transforms_{split}.json").is_file()]
    for split in present:
        _gather(gathering, split, any_lens=any_lens)
    views = gathering.finished(listed_in="transforms_*.json")
    if (known := sidecar.read(folder)) is not None:
        return sidecar.restore(known, views, folder, notes=tuple(gathering.notes))
    if not any(view.split == "test" for view in views):
        train = with_test_views([view for view in views if view.split == "train"], hold_out)
        views = (*train, *(view for view in views if view.split != "train"))
    return assemble.scene(gathering, views, "blender")


def _gather(gathering: assemble.Gathering, split: str, *, any_lens: bool) -> None:
    folder = gathering.folder
    source = folder / f"transforms_{split}.json"
    content = files.read_json(files.within(folder, source))
    frames = opengl.frames_of(content, where=source)
    present = Images(folder, frames, where=source)
    gathering.notes += present.notes
    for frame in frames:
        where = f"{source}, {frame['file_path']}"
        with gathering.collecting():
            image = present.path(frame["file_path"], where=where)
            if image is None:
                gathering.missing.append(frame["file_path"])
                continue
            camera = opengl.camera(content, frame, image, folder, where=where, any_lens=any_lens)
            camera = gathering.fitted(camera, image, where=where)
            named = [(key, image.with_name(image.stem + end)) for key, ends in TRUTH.items() for end in reversed(ends)]
            truth = {key: gathering.file(path, where=where) for key, path in named if path.is_file()}
            name = without_suffix(image.relative_to(folder))
            matrix, scale = opengl.world_from_camera(frame, opengl.axes(content), where=where)
            gathering.scales.append(scale)
            mask = other_path(frame, "mask_path", folder, where=where)
            gathering.views.append(View(name, camera, matrix, split, image, mask, truth))


def save(scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore) -> str:
    """Export a scene; arguments and result are those of `save_scene`."""
    with files.atomic_folder(path) as folder:
        placed = {}
        for view in scene.views:
            name = f"{view.split}/{file_name(view)}"
            placed[name] = export.place(view, folder, name, LAYOUT)
            _shiny_truth(placed[name].view)
            done()
        for split in SPLITS:
            chosen = {name: p.view for name, p in placed.items() if p.view.split == split}
            if chosen or split == "train":
                files.write_json(folder / f"transforms_{split}.json", _transforms(chosen))
        copy_all(extra, folder)
        sidecar.write(folder, scene, {name: p.view for name, p in placed.items()})
    return export.limits(scene, list(placed.values()), LAYOUT)


def _transforms(views: dict[str, View]) -> dict[str, Any]:
    """Content of one transforms file. Several cameras are written per frame, which few programs read."""
    cameras = {view.camera for view in views.values()}

    def frame(name: str, view: View) -> dict[str, Any]:
        suffix = "" if view.image.suffix == ".png" else view.image.suffix
        own = _intrinsics(view) if len(cameras) > 1 else {}
        return {"file_path": f"./{name}{suffix}", **own, "transform_matrix": opengl.transform_matrix(view.world_from_camera)}

    common = _intrinsics(next(iter(views.values()))) if views else {}
    return {**common, "frames": [frame(name, view) for name, view in views.items()]}


def _intrinsics(view: View) -> dict[str, float]:
    camera = view.camera
    size = {"camera_angle_x": 2 * float(np.arctan(0.5 * camera.width / camera.fx)), "w": camera.width, "h": camera.height}
    return {**size, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}


def _shiny_truth(view: View) -> None:
    """Write Shiny Blender's maps beside the image, for other programs."""
    stem = view.image.with_suffix("")
    if "normals" in view.truth:
        images.write(stem.with_name(stem.name + TRUTH["normals"][0]), 0.5 + 0.5 * view.read_truth("normals"))
    if "alpha" in view.truth:
        images.write(stem.with_name(stem.name + TRUTH["alpha"][0]), view.read_truth("alpha")[..., :1])
    if "depth" in view.truth:
        depth = view.read_truth("depth")
        distance = depth * np.linalg.norm(view.camera.directions(view.camera.pixel_centres()), axis=-1, keepdims=True)
        disparity = np.where(depth > 0, 1 / (1 + distance), 0.0)
        images.write(stem.with_name(stem.name + TRUTH["depth"][0]), images.to_uint16(disparity))
