"""Scenes made from scenes: fewer views, other splits, several in one, other images. Sources are never modified.

`subset`, `split` and `merge` only select views. `downscaled`, `undistorted` and `cropped` write new images into a folder and
change intrinsics, truth and sightings accordingly: every ray stays where it was.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import export
from koala3d.datasets.formats.links import file_name
from koala3d.datasets.imaging import downscale, images
from koala3d.datasets.scene import LOSSY, SPLITS, Scene, Sightings, View, with_test_views

Pixels = NDArray[np.float64]
_CENTRED = export.Layout("", lambda camera: camera.is_centred, "", mask="masks/{stem}")


def subset(scene: Scene, *, keep: str = "*", every: int = 1, splits: Sequence[str] = SPLITS) -> Scene:
    """Every `every`-th of the views in the given splits whose names match `keep`, with the wildcards "*" and "?".

    Raises:
        UsageError: there is no such view, or `every` is not positive.
    """
    if every < 1:
        raise UsageError("must be 1 or more", where="every", why=str(every))
    chosen = [view for view in scene.views if view.split in splits and fnmatch(view.name, keep)][::every]
    if not chosen:
        why = f"of {len(scene.views)}, none matches {keep!r} in {', '.join(splits)}"
        raise UsageError("no view is left", where=scene.name, why=why)
    return scene.with_views(tuple(chosen))


def split(scene: Scene, *, every: int = 8, test: str = "", val: str = "") -> Scene:
    """The views whose names match `test` or `val` in these splits, the others for training.

    Where both are empty, every `every`-th view by sorted name, from the first on, is a test view.
    """
    if not (test or val):
        return scene.with_views(with_test_views(scene.views, every))

    def named(view: View) -> str:
        return "test" if test and fnmatch(view.name, test) else "val" if val and fnmatch(view.name, val) else "train"

    views = tuple(replace(view, split=named(view)) for view in scene.views)
    missing = [name for name, pattern in (("test", test), ("val", val)) if pattern and not any(v.split == name for v in views)]
    if missing:
        raise UsageError("no view matches", where=scene.name, why=f"pattern of {', '.join(missing)}")
    return scene.with_views(views)


def merge(scenes: Sequence[Scene], name: str) -> Scene:
    """All views of scenes that share a world. Names that occur twice get their scene's name as a prefix.

    Raises:
        UsageError: there are fewer than two scenes, or they differ in background or unit.
    """
    if len(scenes) < 2:
        raise UsageError("merging needs at least two scenes", where=name)
    for what in ("background", "metric"):
        found = [getattr(scene, what) for scene in scenes]
        if len(set(found)) > 1:
            why = ", ".join(f"{s.name}: {f}" for s, f in zip(scenes, found, strict=True))
            remedy = "merge scenes of one kind, in one coordinate frame"
            raise UsageError(f"scenes differ in {what}", why=why, remedy=remedy)
    names = [view.name for scene in scenes for view in scene.views]
    counts = Counter(names)
    prefixes = [scene.name if [s.name for s in scenes].count(scene.name) == 1 else f"{i}" for i, scene in enumerate(scenes)]
    renamed = [
        {v.name: v.name if counts[v.name] == 1 else f"{prefix}/{v.name}" for v in scene.views}
        for prefix, scene in zip(prefixes, scenes, strict=True)
    ]
    views = [replace(v, name=new[v.name]) for scene, new in zip(scenes, renamed, strict=True) for v in scene.views]
    boxes = np.stack([scene.box for scene in scenes])
    lamps, *others = {scene.lamps for scene in scenes}
    points, colours, sightings = _merged_points(scenes, renamed)
    return replace(
        scenes[0],
        name=name,
        views=tuple(views),
        near=min(s.near for s in scenes),
        far=max(s.far for s in scenes),
        box=np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)]),
        points=points,
        colours=colours,
        sightings=sightings,
        notes=tuple(note for s in scenes for note in s.notes),
        lamps=None if others else lamps,
        provenance={"format": "koala", "merged": [s.provenance for s in scenes]},
        bounds_from="; ".join(dict.fromkeys(s.bounds_from for s in scenes)),
    )


def _merged_points(scenes: Sequence[Scene], renamed: Sequence[dict[str, str]]) -> tuple[Any, Any, Sightings | None]:
    """Points of all scenes; their colours and sightings where all that have points have these too."""
    having = [(s, new) for s, new in zip(scenes, renamed, strict=True) if s.points is not None]
    if not having:
        return None, None, None
    points = np.concatenate([scene.points for scene, _ in having if scene.points is not None])
    coloured = [scene.colours for scene, _ in having if scene.colours is not None]
    colours = np.concatenate(coloured) if len(coloured) == len(having) else None
    names: list[str] = []
    index, pixels, first = [], [], 0
    for scene, new in having:
        if scene.sightings is None or scene.points is None:
            return points, colours, None
        index.append(scene.sightings.index + np.array([first, len(names)]))
        pixels.append(scene.sightings.pixels)
        names += [new.get(name, name) for name in scene.sightings.names]
        first += len(scene.points)
    return points, colours, Sightings(tuple(names), np.concatenate(index), np.concatenate(pixels))


def downscaled(scene: Scene, factor: int, folder: Path, *, done: Step = ignore) -> Scene:
    """The scene with all images at 1/`factor` of their size, as area averages of linear light, written below `folder`."""
    if factor < 2:
        raise UsageError("must be 2 or more", where="factor", why=str(factor))
    views = []
    for view in scene.views:
        small = downscale.camera(view.camera, factor)
        image = _path(folder, "images", view, view.image)
        downscale.Job(view.image, image, small.width, small.height).run()
        mask = _path(folder, "masks", view, view.mask) if view.mask else None
        if view.mask and mask:
            downscale.Job(view.mask, mask, small.width, small.height, colours=False).run()
        truth = {}
        for key in view.truth:
            truth[key] = _exr(folder, key, view)
            images.write(truth[key], _smaller_truth(key, view.read_truth(key), small))
        views.append(replace(view, camera=small, image=image, mask=mask, truth=truth, deviation=None))
        done()
    ratios = {
        old.name: np.array([new.camera.width / old.camera.width, new.camera.height / old.camera.height])
        for old, new in zip(scene.views, views, strict=True)
    }
    return _with_views(scene, views, lambda name, pixels: pixels * ratios[name])


def _smaller_truth(key: str, values: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Area averages: of normals, brought to unit length again; of depth, over the pixels that have one."""
    small = images.resize(values, camera.width, camera.height, srgb=False)
    if key == "normals":
        length = np.linalg.norm(small, axis=-1, keepdims=True)
        return np.where(length > 0.5, small / np.maximum(length, 0.5), 0.0).astype(np.float32)
    if key == "depth":
        share = images.resize((values > 0).astype(np.float32), camera.width, camera.height, srgb=False)
        return np.where(share > 0.5, small / np.maximum(share, 0.5), 0.0).astype(np.float32)
    return small


def undistorted(scene: Scene, folder: Path, *, done: Step = ignore) -> Scene:
    """The scene with every view as a centred pinhole, written below `folder`; views that already are one keep their files."""
    placed = export.place_all(scene.views, folder, lambda view: f"images/{file_name(view)}", _CENTRED, done)
    views = [one.view for one in placed]
    pairs = {old.name: (old, new) for old, new in zip(scene.views, views, strict=True)}

    def moved(name: str, pixels: Pixels) -> Pixels:
        return export.moved(*pairs[name], pixels)

    return _with_views(scene, views, moved)


def cropped(scene: Scene, left: int, top: int, width: int, height: int, folder: Path, *, done: Step = ignore) -> Scene:
    """The scene with every image cropped to `width` x `height` pixels from (`left`, `top`), written below `folder`.

    Raises:
        UsageError: an image does not contain that rectangle.
    """
    for view in scene.views:
        full = view.camera
        if min(left, top) < 0 or min(width, height) < 1 or left + width > full.width or top + height > full.height:
            why = f"{width}x{height} at ({left}, {top}) of {full.width}x{full.height}"
            raise UsageError("image does not contain this rectangle", where=f"view {view.name}", why=why)

    def cut(source: Path, target: Path) -> Path:
        stored = images.read_stored(source)[top : top + height, left : left + width]
        images.write(target, stored, metadata=images.metadata(source))
        return target

    views = []
    for view in scene.views:
        camera = replace(view.camera, width=width, height=height, cx=view.camera.cx - left, cy=view.camera.cy - top)
        mask = cut(view.mask, _path(folder, "masks", view, view.mask)) if view.mask else None
        ignored = cut(view.ignored, _path(folder, "ignored", view, view.ignored)) if view.ignored else None
        truth = {key: cut(path, _path(folder, f"truth/{key}", view, path)) for key, path in view.truth.items() if key != "depth"}
        if "depth" in view.truth:  # may be encoded along the rays of the old camera
            truth["depth"] = _exr(folder, "depth", view)
            images.write(truth["depth"], view.read_truth("depth")[top : top + height, left : left + width])
        image = cut(view.image, _path(folder, "images", view, view.image))
        view = replace(view, camera=camera, image=image, mask=mask, ignored=ignored)
        views.append(replace(view, truth=truth, deviation=None))
        done()
    return _with_views(scene, views, lambda name, pixels: pixels - [left, top])


def _path(folder: Path, below: str, view: View, source: Path) -> Path:
    suffix = ".png" if source.suffix.lower() in LOSSY else source.suffix  # compressed again, it would lose more
    return files.target(folder, f"{below}/{file_name(view)}{suffix}")


def _exr(folder: Path, key: str, view: View) -> Path:
    return files.target(folder, f"truth/{key}/{file_name(view)}.exr")


def _with_views(scene: Scene, views: Sequence[View], moved: Callable[[str, Pixels], Pixels]) -> Scene:
    """The scene with other images; sightings move with them, and those outside the new image are dropped."""
    old = scene.sightings
    if old is None:
        return scene.with_views(tuple(views))
    cameras = {view.name: view.camera for view in views}
    pixels, kept = old.pixels.copy(), np.zeros(len(old.pixels), bool)
    for number, name in enumerate(old.names):
        rows = np.flatnonzero(old.index[:, 1] == number)
        if name in cameras and len(rows):
            pixels[rows] = moved(name, old.pixels[rows])
            kept[rows] = ((pixels[rows] >= 0) & (pixels[rows] <= [cameras[name].width, cameras[name].height])).all(1)
    sightings = replace(old, index=old.index[kept], pixels=pixels[kept])
    return replace(scene, views=tuple(views), sightings=sightings)
