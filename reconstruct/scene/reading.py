"""What a training reads of its scene's pictures before it starts."""

import numpy as np

from datasets.core.console import progress
from datasets.imaging.copies import Copies
from datasets.scene import Scene, View
from reconstruct.scene.pool import Pool
from reconstruct.scene.rays import Normalisation, Pixels, pixel_counts

PROBE = 4096
"""Pixels of test views that each line of the log measures; never trained on, and not part of the training's time."""


def training_pixels(
    views: tuple[View, ...], normalisation: Normalisation, scale: float, copies: Copies | None = None
) -> tuple[Pixels, Pool | None]:
    """The pixels to draw from, and what renews them where they are only a part of all."""
    pool = Pool(views, normalisation, scale, copies)
    with progress("reading images", len(views), "images") as shown:
        if pool.is_needed:
            return pool.pixels(shown), pool
        return Pixels.load(views, normalisation, scale, shown, copies=copies), None


def held_out(pixels: Pixels, pool: Pool | None) -> tuple[Pixels, Pixels]:
    """The pixels to train on, and some that are never trained on."""
    if pool is None:
        return pixels.held_out(PROBE)
    with progress("reading held-out pixels", len(pool.views), "images") as shown:
        return pixels, pool.held_out(shown)


def probe(
    scene: Scene, normalisation: Normalisation, scale: float, copies: Copies | None = None
) -> tuple[np.ndarray, ...] | None:
    """Random pixels of a few test views: (origins, directions, radii, colour over white); None where there are no such views."""
    views = [view for view in scene.views if view.split == "test"]
    if not views:
        return None
    views = tuple(views[:: max(1, len(views) // 4)][:4])
    ends = np.cumsum(pixel_counts(views, scale))
    index = np.random.default_rng(0).choice(ends[-1], min(PROBE, ends[-1]), replace=False)
    owner = np.searchsorted(ends, index, side="right")
    chosen = [index[owner == view] - start for view, start in enumerate(np.concatenate([[0], ends[:-1]]))]
    with progress("reading unseen pixels", len(views), "images") as shown:
        pixels = Pixels.load(views, normalisation, scale, shown, copies=copies, chosen=chosen)
    return pixels.over_white(np.argsort(np.argsort(owner, kind="stable"), kind="stable"))
