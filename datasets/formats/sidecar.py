"""`koala.json` beside an exported folder: what Blender's and LLFF's layouts cannot say.

Other programs do not look at it; Koala's readers take split, names, truth, masks, bounds and background from it, so
that an exported scene trains as the one that it came from.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from datasets.core import files
from datasets.core.errors import DatasetError
from datasets.scene import SPLITS, STATED, Scene, View

FILE = "koala.json"
FORMAT, VERSION = "koala-sidecar", 1


def write(folder: Path, scene: Scene, views: dict[str, View]) -> None:
    """Write what a layout cannot say. `views` maps its own name of each view to the view as exported."""

    def relative(path: Path) -> str:
        return path.relative_to(folder).as_posix()

    files.write_json(
        folder / FILE,
        {
            "format": FORMAT,
            "version": VERSION,
            **facts(scene),
            "views": {
                name: {
                    "name": view.name,
                    "split": view.split,
                    "truth": {k: relative(p) for k, p in view.truth.items()},
                    "depth_unit": view.depth_unit,
                }
                for name, view in views.items()
            },
        },
    )


def facts(scene: Scene) -> dict[str, Any]:
    """What is true of a scene as a whole, for JSON; an infinite far is null."""
    return {
        "name": scene.name,
        "metric": scene.metric,
        "background": scene.background,
        "near": scene.near,
        "far": scene.far if np.isfinite(scene.far) else None,
        "box": scene.box.tolist(),
        "bounds_from": scene.bounds_from,
        "notes": list(scene.notes),
        "provenance": scene.provenance,
    }


def scene_of(content: dict[str, Any], views: tuple[View, ...], *, where: object) -> Scene:
    """Scene from `facts` and views.

    Raises:
        DatasetError: a fact is missing or impossible.
    """
    try:
        near, far = float(content["near"]), np.inf if content["far"] is None else float(content["far"])
        box = np.asarray(content["box"], np.float64).reshape(2, 3)
        name, background, metric = str(content["name"]), content["background"], bool(content["metric"])
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError("scene is not complete", where=where, why=f"{type(error).__name__} {error}") from None
    if background not in ("white", "scene"):
        raise DatasetError(f"no background called {background!r}", where=where, remedy="valid: scene, white")
    if not (np.isfinite(box).all() and (box[0] < box[1]).all()):
        raise DatasetError("box is empty or not finite", where=where, why=str(box.tolist()))
    if not 0 <= near < far:
        raise DatasetError("near and far are not in order", where=where, why=f"near {near}, far {far}")
    return Scene(
        name,
        views,
        near,
        far,
        box,
        background,
        metric,
        notes=tuple(content.get("notes", ())),
        provenance=content.get("provenance", {}),
        bounds_from=str(content.get("bounds_from", STATED)),
    )


def read(folder: Path) -> dict[str, Any] | None:
    """The sidecar's content, or None where there is none."""
    if not (folder / FILE).is_file():
        return None
    content = files.read_json(files.inside(folder, FILE), kind=FORMAT, version=VERSION)
    if not isinstance(content.get("views"), dict):
        raise DatasetError("holds no views by name", where=folder / FILE)
    return content


def name_of(content: dict[str, Any], name: str) -> str:
    """What a view that the layout calls `name` was called in the scene that was exported."""
    said = content["views"].get(name)
    return str(said["name"]) if isinstance(said, dict) and "name" in said else name


def restore(content: dict[str, Any], views: tuple[View, ...], folder: Path, *, notes: tuple[str, ...]) -> Scene:
    """The scene that was exported: views of the layout with the sidecar's names, splits, truth and facts."""
    where = folder / FILE
    known = content["views"]

    def restored(view: View) -> View:
        said = known.get(view.name)
        if said is None:
            return view
        try:
            truth = {key: files.inside(folder, path, where=where) for key, path in said["truth"].items()}
            if said["split"] not in SPLITS:
                raise DatasetError(f"no split called {said['split']!r}", where=f"{where}, {view.name}")
            unit = float(said.get("depth_unit", view.depth_unit))
            return replace(view, name=str(said["name"]), split=said["split"], truth=truth, depth_unit=unit)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise DatasetError("view is not complete", where=f"{where}, {view.name}", why=str(error)) from None

    order: dict[str, int] = {name: index for index, name in enumerate(known)}
    by_order: Callable[[View], int] = lambda view: order.get(view.name, len(order))  # noqa: E731
    scene = scene_of(content, tuple(restored(view) for view in sorted(views, key=by_order)), where=where)
    return replace(scene, notes=(*scene.notes, *notes))
