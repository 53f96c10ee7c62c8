"""A scene written with the masks that were found for it, and the strokes behind them."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.files import refuse_existing
from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.formats import koala
from koala3d.datasets.formats.links import Extra
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import MASKS_FROM, PICTURES, STATED, Scene
from koala3d.datasets.segmentation import strokes
from koala3d.datasets.segmentation.grow import enlarged
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks.hull import visual_hull
from koala3d.datasets.structure.masks.silhouette import silhouettes

STROKES = "strokes.json"


def write(
    scene: Scene,
    masks: Sequence[NDArray[np.bool_]],
    drawn: Sequence[strokes.Stroke],
    out: Path,
    *,
    known_shape: bool = False,
    extra: Extra = None,
    done: Step = ignore,
) -> None:
    """Write a Koala scene whose masks are those found, all or nothing; strokes go to `STROKES` in its folder.

    Args:
        masks: (height, width) of each view, of its picture's size or smaller.
        known_shape: they are of a mesh, and not found in the pictures; the scene's provenance says which (`MASKS_FROM`).
        extra: more files of the scene, by their path in it.

    Raises:
        UsageError: `out` exists.
    """
    refuse_existing(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as work:
        views = []
        for number, (view, mask) in enumerate(zip(scene.views, masks, strict=True)):
            path = Path(work) / f"{number:05}.png"
            images.write(path, enlarged(mask, view.camera.width, view.camera.height))
            views.append(replace(view, mask=path, mask_inverted=False))
            done()
        provenance = {**scene.provenance, MASKS_FROM: "mesh" if known_shape else PICTURES}
        koala.save(alone(replace(scene.with_views(tuple(views)), provenance=provenance)), out, extra=extra)
    if drawn:
        strokes.write(out / STROKES, drawn)


def alone(scene: Scene) -> Scene:
    """A scene whose views have masks, with the object as all there is: bounds are those of its hull, a stated box stays."""
    train = tuple(view for view in scene.views if view.split == "train") or scene.views
    stated = scene.box_is_stated
    hull = visual_hull(silhouettes(train), scene.box if stated else bounds.visible_box(train))
    near, far = hull.depth_range(scene.views)
    box, words = (scene.box, STATED) if stated else (hull.box, f"masks of {hull.views_used} views")
    return replace(scene, background="white", box=box, near=near, far=far, bounds_from=words)
