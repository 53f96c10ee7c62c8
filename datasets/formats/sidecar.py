"""`koala.json` in an exported folder: what foreign formats cannot hold.

Other programs ignore it. Koala's readers take splits, names, truth, bounds and background from it, so that an exported scene
trains like the original.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.scene import CHANNELS, LAMPS, SPLITS, STATED, Scene, View, checked_name
from koala3d.datasets.turntable import before_turntable

FILE = "koala.json"
FORMAT, VERSION = "koala-sidecar", 1


def write(folder: Path, scene: Scene, views: dict[str, View]) -> None:
    """Write what a format cannot hold. `views` maps the format's name of each view to the view as exported."""

    def entry(index: int, view: View) -> dict[str, Any]:
        truth = {key: path.relative_to(folder).as_posix() for key, path in view.truth.items()}
        found = {"index": index, "name": view.name, "split": view.split, "truth": truth, "depth_unit": view.depth_unit}
        found |= placed(view)
        return found | {"mask_ignores": True} if view.ignored else found

    entries = {name: entry(index, view) for index, (name, view) in enumerate(views.items())}
    content = {"format": FORMAT, "version": VERSION, **facts(scene), "views": entries}
    files.write_json(folder / FILE, content)


def facts(scene: Scene) -> dict[str, Any]:
    """The values of a whole scene, for JSON; an infinite far is null."""
    keys = ("name", "metric", "background", "near", "far", "box", "bounds_from", "notes", "provenance")
    keys += ("lamps",) if scene.lamps is not None else ()
    far = scene.far if np.isfinite(scene.far) else None
    return {key: getattr(scene, key) for key in keys} | {"far": far}


def scene_of(content: dict[str, Any], views: tuple[View, ...], *, where: object) -> Scene:
    """Scene from `facts` and views. Raises DatasetError where a fact is missing or impossible."""
    try:
        near, far = float(content["near"]), np.inf if content["far"] is None else float(content["far"])
        box = np.asarray(content["box"], np.float64).reshape(2, 3)
        name, background, metric = str(content["name"]), content["background"], bool(content["metric"])
        notes, provenance = tuple(map(str, content.get("notes", ()))), content.get("provenance", {})
        json.dumps(provenance, allow_nan=False)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError("scene is not complete", where=where, why=f"{type(error).__name__} {error}") from None
    if background not in ("white", "scene"):
        raise DatasetError(f"no background called {background!r}", where=where, remedy="valid: scene, white")
    if not (np.isfinite(box).all() and (box[0] < box[1]).all()):
        raise DatasetError("box is empty or not finite", where=where, why=str(box.tolist()))
    if not 0 <= near < far:
        raise DatasetError("near and far are not in order", where=where, why=f"near {near}, far {far}")
    evidence, lamps = str(content.get("bounds_from", STATED)), content.get("lamps")
    if lamps is not None and lamps not in LAMPS:
        raise DatasetError(f"no lamps on {str(lamps)[:80]!r}", where=where, remedy=f"valid: {', '.join(LAMPS)}")
    more: dict[str, Any] = {"notes": notes, "provenance": provenance, "bounds_from": evidence, "lamps": lamps}
    return _as_older_files_say(Scene(name, views, near, far, box, background, metric, **more), content, where)


def _as_older_files_say(scene: Scene, content: dict[str, Any], where: object) -> Scene:
    """The scene with the `light_frame` and `light_axis` of files that name the frame in which lamps stand still.

    Of a turntable they hold the axis alone. The views get poses that turn about it, as far as the camera stood on one side of
    the room. Raises DatasetError where they are impossible.
    """
    frame, axis = content.get("light_frame"), content.get("light_axis")
    if frame is None:
        return scene
    if frame not in ("world", "camera", "turntable"):
        raise DatasetError(f"no light frame called {str(frame)[:80]!r}", where=where, remedy="valid: world, camera, turntable")
    if frame != "turntable":
        return replace(scene, lamps="object" if frame == "world" else "camera")
    if axis is None:
        return replace(scene, lamps="room")
    try:
        x, y, z = (float(value) for value in axis)
    except (TypeError, ValueError) as error:
        raise DatasetError("light_axis is no vector", where=where, why=str(error)) from None
    if not abs(np.linalg.norm([x, y, z]) - 1) < 1e-3:
        raise DatasetError("light_axis is no unit vector", where=where, why=str([x, y, z]))
    turned = before_turntable((x, y, z), np.stack([view.world_from_camera[:3, :3] for view in scene.views]))
    views = (replace(v, base_from_world=pose.rigid(r, np.zeros(3))) for v, r in zip(scene.views, turned, strict=True))
    return replace(scene, views=tuple(views), lamps="room")


def placed(view: View) -> dict[str, Any]:
    """Where the object was, for JSON; empty where that is not known."""
    return {} if view.base_from_world is None else {"base_from_world": view.base_from_world.tolist()}


def place_of(entry: dict[str, Any], *, where: object) -> NDArray[np.float64] | None:
    """(4, 4) inverse of `placed`. Raises DatasetError where it is no pose."""
    given = entry.get("base_from_world")
    return None if given is None else pose.checked(given, where=f"{where}, base_from_world")


def truth_of(content: Any, folder: Path, *, where: object) -> dict[str, Path]:
    """Truth maps by channel as a file lists them. Raises DatasetError where a channel is unknown or a path leaves the folder."""
    for key in content:
        if key not in CHANNELS:
            raise DatasetError(f"no truth channel called {str(key)[:80]!r}", where=where, remedy=f"valid: {', '.join(CHANNELS)}")
    return {key: files.inside(folder, path, where=where) for key, path in content.items()}


def unit_of(entry: dict[str, Any], otherwise: float) -> float:
    """World units per step of a view's depth file. Raises ValueError where it is not positive."""
    unit = float(entry.get("depth_unit", otherwise))
    if not 0 < unit < np.inf:
        raise ValueError(f"depth_unit is {unit}")
    return unit


def read(folder: Path) -> dict[str, Any] | None:
    """The sidecar's content, or None where there is none."""
    if not (folder / FILE).is_file():
        return None
    content = files.read_json(files.inside(folder, FILE), kind=FORMAT, version=VERSION)
    if not isinstance(content.get("views"), dict):
        raise DatasetError("holds no views by name", where=folder / FILE)
    return content


def name_of(content: dict[str, Any], name: str) -> str:
    """Original name of the view that the format calls `name`."""
    entry = content["views"].get(name)
    return str(entry["name"]) if isinstance(entry, dict) and "name" in entry else name


def restore(content: dict[str, Any], views: tuple[View, ...], folder: Path, *, notes: tuple[str, ...]) -> Scene:
    """The original scene: views of the format with the names, splits, truth and facts of the sidecar."""
    where = folder / FILE
    known = content["views"]

    def restored(view: View) -> View:
        entry = known.get(view.name)
        if entry is None:
            return view
        try:
            truth = truth_of(entry["truth"], folder, where=f"{where}, {view.name}")
            name = checked_name(entry["name"], where=f"{where}, {view.name}")
            if entry["split"] not in SPLITS:
                raise DatasetError(f"no split called {entry['split']!r}", where=f"{where}, {view.name}")
            unit = unit_of(entry, view.depth_unit)
            view = replace(view, base_from_world=place_of(entry, where=f"{where}, {view.name}"))
            if entry.get("mask_ignores") is True:
                view = replace(view, mask=None, ignored=view.mask)
            return replace(view, name=name, split=entry["split"], truth=truth, depth_unit=unit)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise DatasetError("view is not complete", where=f"{where}, {view.name}", why=str(error)) from None

    def place(view: View) -> int:
        entry = known.get(view.name)
        index = entry.get("index") if isinstance(entry, dict) else None
        return index if isinstance(index, int) else len(known)

    ordered = sorted(views, key=place)
    scene = scene_of(content, tuple(map(restored, ordered)), where=where)
    return replace(scene, notes=(*scene.notes, *notes))
