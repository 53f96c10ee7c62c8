"""A scene written with the masks that were found for it, and the strokes behind them."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from datasets.core.files import refuse_existing
from datasets.core.progress import Step, ignore
from datasets.formats import koala
from datasets.imaging import images
from datasets.scene import Scene
from datasets.segmentation import strokes
from datasets.segmentation.grow import Grown, enlarged

STROKES = "strokes.json"


def write(scene: Scene, found: Grown, drawn: Sequence[strokes.Stroke], out: Path, *, done: Step = ignore) -> None:
    """Write a Koala scene whose masks are those found, all or nothing; strokes go to `STROKES` in its folder.

    Raises:
        UsageError: `out` exists.
    """
    refuse_existing(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as work:
        views = []
        for number, (view, mask) in enumerate(zip(scene.views, found.masks, strict=True)):
            path = Path(work) / f"{number:05}.png"
            images.write(path, enlarged(mask, view.camera.width, view.camera.height))
            views.append(replace(view, mask=path, mask_inverted=False))
            done()
        koala.save(scene.with_views(tuple(views)), out)
    if drawn:
        strokes.write(out / STROKES, drawn)
