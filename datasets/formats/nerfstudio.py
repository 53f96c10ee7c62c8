"""nerfstudio and instant-ngp folders: one `transforms.json`, OpenGL camera axes, OpenCV distortion.

The world is that of the file: `applied_transform` and instant-ngp's `scale`, `offset` and `aabb_scale` are not applied.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError, KoalaError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import assemble, export, opengl, ply, sidecar
from koala3d.datasets.formats.finding.pictures import without_suffix
from koala3d.datasets.formats.finding.stated import Images, leaves, other_path, plain
from koala3d.datasets.formats.links import Extra, copy_all, file_name, write_smaller
from koala3d.datasets.imaging import downscale, images
from koala3d.datasets.scene import SPLITS, Scene, View, with_test_views

FILE = "transforms.json"
LAYOUT = export.Layout(
    "nerfstudio's layout",
    lambda camera: camera.spline is None and (camera.fisheye or not (camera.k4 or camera.k5 or camera.k6)),
    "a rational or splined lens",
    mask="masks/{stem}",
)
DEPTHS = ("depth_file_path", "depth_path")
"""Keys of a frame's depth, of nerfstudio and of instant-ngp."""
SHUTTERS = ("rolling_shutter", "rolling_shutter_time", "velocity")
"""Keys of what a camera does while its picture is read out."""
DYNAMIC = "dynamic_mask_"
"""What the names of instant-ngp's masks of moving things begin with."""
DEPTH_STEP = 1e-3
"""World units per step of the depth files that are written (nerfstudio's default)."""


def detect(folder: Path) -> bool:
    """True for a folder with `transforms.json`."""
    return (folder / FILE).is_file()


def load(
    folder: Path,
    *,
    hold_out: int = 8,
    images_folder: str | None = None,
    problems: list[KoalaError] | None = None,
    any_lens: bool = False,
) -> Scene:
    """Read a nerfstudio folder; missing images are left out and named in the notes. `any_lens` is that of `opengl.camera`.

    Views are sorted by file name. Without `train_filenames` and the like, every `hold_out`-th view is a test view.
    """
    source = folder / FILE
    content = _with_test_frames(files.read_json(files.within(folder, source)))
    gathering = assemble.Gathering(folder, problems)
    stated = _splits(content, where=source)
    frames = sorted(_used(gathering, content, stated, where=source), key=lambda frame: frame["file_path"])
    present = Images(folder, frames, where=source, home=images_folder)
    gathering.notes += present.notes
    for frame in frames:
        with gathering.collecting():
            _gather(gathering, content, frame, stated, present, any_lens=any_lens)
    if not any(view.mask for view in gathering.views) and len({view.image.parent for view in gathering.views}) == 1:
        home = gathering.views[0].image.parent
        masks = gathering.masks(home, [view.image.name for view in gathering.views])
        gathering.views = [replace(view, mask=mask) for view, mask in zip(gathering.views, masks, strict=True)]
        gathering.notes += [f"masks are used that {FILE} does not name"] if any(masks) else []
    views = gathering.finished(listed_in=FILE)
    points, colours = _points(gathering, content, where=source)
    known = sidecar.read(folder)
    if known is not None:
        return replace(sidecar.restore(known, views, folder, notes=tuple(gathering.notes)), points=points, colours=colours)
    gathering.notes += _unused(content, frames, views)
    if not stated:
        views = with_test_views(views, hold_out)
    scene = assemble.scene(gathering, views, "nerfstudio")
    return scene if points is None else replace(assemble.with_points(scene, points), colours=colours)


def _with_test_frames(content: Any) -> Any:
    """The file's content with ScanNet++'s `test_frames` among its frames, and lists that say so."""
    extra, frames = (content.get(key) if isinstance(content, dict) else None for key in ("test_frames", "frames"))
    if not isinstance(extra, list) or not isinstance(frames, list) or not extra:
        return content
    names = [[one["file_path"] for one in part if isinstance(one, dict) and "file_path" in one] for part in (frames, extra)]
    return {**content, "frames": [*frames, *extra], "train_filenames": names[0], "test_filenames": names[1]}


def _used(gathering: assemble.Gathering, content: Any, stated: dict[str, str], *, where: object) -> list[dict[str, Any]]:
    """The frames that the file means to be used; notes on the others."""
    frames = opengl.frames_of(content, where=where)
    listed = [frame for frame in frames if not stated or frame["file_path"] in stated]
    good = [frame for frame in listed if not frame.get("is_bad")]
    if absent := len(frames) - len(listed):
        gathering.notes.append(f"{absent} of {len(frames)} frames are in no list of file names and are left out")
    if bad := len(listed) - len(good):
        gathering.notes.append(f"{bad} frames that the file calls bad are left out")
    return good


def _unused(content: dict[str, Any], frames: Sequence[dict[str, Any]], views: Sequence[View]) -> list[str]:
    """Notes on what the frames state, or lies beside their images, and is not read."""
    notes, times = [], {frame.get("time") for frame in frames}
    if len(times - {None}) > 1:
        notes.append(f"frames are of {len(times)} times; what moves in between is not known: the scene is read as one at rest")
    if any(frame.get(key) for frame in frames for key in DEPTHS):
        notes.append("depth of the frames may be a sensor's or an estimate: it is not read as truth")
    if any(content.get(key) or any(frame.get(key) for frame in frames) for key in SHUTTERS):
        notes.append("the motion of a rolling shutter is not read: each picture has one pose")
    if any(view.image.with_name(f"{DYNAMIC}{view.image.stem}.png").is_file() for view in views):
        notes.append(f"pictures {DYNAMIC}*.png, which hide what moves, are not used: give masks of the object instead")
    return notes


def _points(
    gathering: assemble.Gathering, content: dict[str, Any], *, where: object
) -> tuple[NDArray[np.float64] | None, NDArray[np.uint8] | None]:
    """Surface points of `ply_file_path`, which are in the world of the frames, and their colours."""
    path = other_path(content, "ply_file_path", gathering.folder, where=where)
    if path is None or not path.is_file():
        return None, None
    cloud = ply.read_cloud(path)
    if cloud.not_finite:
        gathering.notes.append(f"{cloud.not_finite} points of {path.name} are not finite and are left out")
    return cloud.points, cloud.colours


def _gather(
    gathering: assemble.Gathering,
    content: dict[str, Any],
    frame: dict[str, Any],
    stated: dict[str, str],
    present: Images,
    *,
    any_lens: bool,
) -> None:
    folder, listed = gathering.folder, frame["file_path"]
    where = f"{folder / FILE}, {listed}"
    image = present.path(listed, where=where)
    if image is None:
        gathering.missing.append(listed)
        return
    camera = gathering.fitted(opengl.camera(content, frame, image, folder, where=where, any_lens=any_lens), image, where=where)
    mask, path = other_path(frame, "mask_path", folder, where=where), plain(listed)
    name = without_suffix(image.relative_to(folder) if leaves(path) else path)
    matrix, scale = opengl.world_from_camera(frame, opengl.axes(content), where=where)
    gathering.scales.append(scale)
    gathering.views.append(View(name, camera, matrix, stated.get(listed, "train"), image, mask))


def _splits(content: Any, *, where: object) -> dict[str, str]:
    """Split of each file path, where the file has such lists; empty where it has none."""
    if not isinstance(content, dict):
        raise DatasetError("holds no list of frames", where=where)
    listed = {split: content[f"{split}_filenames"] for split in SPLITS if f"{split}_filenames" in content}
    if not all(isinstance(names, list) and all(isinstance(name, str) for name in names) for names in listed.values()):
        raise DatasetError("lists of file names hold something else", where=where, why=", ".join(listed))
    frames = {frame["file_path"] for frame in opengl.frames_of(content, where=where)}
    for split, names in listed.items():
        stray = sorted(set(names) - frames)
        if stray:
            raise DatasetError(
                f"{split}_filenames lists names that are not among the frames", where=where, why=", ".join(stray[:5])
            )
    return {name: split for split, names in listed.items() for name in names}


def save(scene: Scene, path: Path, *, extra: Extra = None, done: Step = ignore, sizes: tuple[int, ...] = ()) -> str:
    """Export a scene; arguments and result are those of `save_scene`.

    Depth is included, in steps of `DEPTH_STEP`, where all views have it and it fits into 16 bits; `sizes` are made of it as well.
    """
    with files.atomic_folder(path) as folder:
        placed = export.place_all(scene.views, folder, lambda view: f"images/{file_name(view)}", LAYOUT, done)
        views = [p.view for p in placed]
        write_smaller(views, folder, sizes, lambda view, source: source.name)
        _harden(views, folder, sizes)
        content = _global(scene, views)
        depths = _depths(views, folder, sizes)
        content["frames"] = [_frame(view, folder, depths.get(view.name), common="fl_x" in content) for view in views]
        if scene.points is not None:
            ply.write_points(folder / "sparse.ply", scene.points, scene.colours)
            content["ply_file_path"] = "sparse.ply"
        files.write_json(folder / FILE, content)
        copy_all(extra, folder)
        sidecar.write(folder, scene, {v.image.relative_to(folder).with_suffix("").as_posix(): v for v in views})
    return export.limits(scene, placed, LAYOUT)


def _global(scene: Scene, views: Sequence[View]) -> dict[str, Any]:
    """Content of the file that all frames share."""
    reach = max(float(np.abs(scene.box).max()), 1e-9) * 0.33 + 0.5  # instant-ngp's own scale and offset
    aabb = int(min(2 ** np.ceil(np.log2(max(2 * reach - 1, 1.0))), 128)) if scene.background == "white" else 16
    cameras = {view.camera for view in views}
    common = _intrinsics(views[0].camera) if len(cameras) == 1 else {}
    if len({camera.fisheye for camera in cameras}) == 1:  # nerfstudio reads no lens model of single frames
        common["camera_model"] = _model(views[0].camera)
    transform = {"applied_transform": np.eye(4)[:3].tolist(), "orientation_override": "none"}
    return {**common, "aabb_scale": aabb, "depth_unit_scale_factor": DEPTH_STEP, **transform, **_listed(views)}


def _harden(views: Sequence[View], folder: Path, sizes: Sequence[int]) -> None:
    """Make smaller masks black and white: to nerfstudio all but black is the object, half a pixel of surroundings included."""
    for size, mask in ((size, view.mask) for size in sizes for view in views if view.mask is not None):
        path = folder / f"masks_{size}" / mask.name
        images.write(path, np.uint8(255) * (images.read(path)[..., :1] >= 0.5))


def _listed(views: Sequence[View]) -> dict[str, list[str]]:
    """The lists of splits. nerfstudio needs all three, and fails on an empty one: test and validation views stand in for each
    other. Without any of them, or without training views, there are no lists, and nerfstudio chooses.
    """
    names = {split: [f"images/{view.image.name}" for view in views if view.split == split] for split in SPLITS}
    held_out = names["test"] or names["val"]
    if not held_out or not names["train"]:
        return {}
    return {
        "train_filenames": names["train"],
        "val_filenames": names["val"] or held_out,
        "test_filenames": held_out,
    }


def _model(camera: Camera) -> str:
    return opengl.FISHEYE if camera.fisheye else "OPENCV"


def _intrinsics(camera: Camera) -> dict[str, Any]:
    values: dict[str, Any] = {
        "camera_model": _model(camera),
        "w": camera.width,
        "h": camera.height,
    }
    values |= {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    terms = ("k1", "k2", "k3", "k4") if camera.fisheye else ("k1", "k2", "k3", "p1", "p2")
    return values | {term: getattr(camera, term) for term in terms}


def _frame(view: View, folder: Path, depth: Path | None, *, common: bool) -> dict[str, Any]:
    own = {} if common else _intrinsics(view.camera)
    if (hidden := view.mask or view.ignored) is not None:
        own["mask_path"] = hidden.relative_to(folder).as_posix()
    if depth is not None:
        own["depth_file_path"] = depth.relative_to(folder).as_posix()
    return {"file_path": f"images/{view.image.name}", **own, "transform_matrix": opengl.transform_matrix(view.world_from_camera)}


def _depths(views: Sequence[View], folder: Path, sizes: Sequence[int]) -> dict[str, Path]:
    """16-bit depth of every view by its name, also at smaller sizes; empty where not all have it, or it does not fit."""
    if not all("depth" in view.truth for view in views):
        return {}
    written = {}
    for view in views:
        counts = view.read_truth("depth") / DEPTH_STEP
        if counts.max(initial=0) > 65535:
            return {}
        counts = np.where(np.isnan(counts), 0, counts)  # the format's value of a pixel without depth
        steps = counts.round().clip(0, 65535).astype(np.uint16)
        written[view.name] = folder / "depths" / f"{view.image.stem}.png"
        images.write(written[view.name], steps)
        for size in sizes:
            small = downscale.camera(view.camera, size)
            rows, columns = _nearest(len(steps), small.height), _nearest(steps.shape[1], small.width)
            images.write(folder / f"depths_{size}" / f"{view.image.stem}.png", steps[rows[:, None], columns])
    return written


def _nearest(count: int, fewer: int) -> NDArray[np.int64]:
    """(fewer,) of `count` pixels those nearest to the centres of larger ones: depth is not mixed across edges."""
    return ((np.arange(fewer) + 0.5) * count / fewer).astype(np.int64)
