"""Whether masks show the object in white or in black: told by the border of the pictures and by the visual hull.

An object seldom covers the border of most pictures, and its masks are the outlines of one body: the hull carved by all of them
covers each of them again. The masks of what is around an object have no common body, so that their hull covers less of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.scene import View
from datasets.structure.bounds import visible_box
from datasets.structure.hull import Hull, visual_hull

CLEAR_BORDER = 0.2
"""Share of white on the borders up to which white is the object without a further look."""
CLEAR_GAP = 0.05
"""Difference of the hulls' agreement with their masks from which it decides; below, the border does."""
VIEWS = 12
"""Number of views whose masks are read."""
_GRID = 32
"""Cells of a picture's longer side in which agreement is counted; with one cell of slack, coarser than the hull's voxels."""


def inverted(views: Sequence[View]) -> str:
    """Why black is the object in these masks, in a few words; empty where white is. The views must all have masks."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, VIEWS).round().astype(int))]
    border = float(np.mean([_border(view) for view in chosen]))
    if border <= CLEAR_BORDER:
        return ""
    as_white = agreement(chosen)
    as_black = agreement([replace(view, mask_inverted=True) for view in chosen])
    gap = as_black - as_white
    if gap < -CLEAR_GAP or (gap <= CLEAR_GAP and border <= 0.5):
        return ""
    return f"{border:.0%} of the borders are white, and the hull of black covers {as_black:.0%} of it, that of white {as_white:.0%}"


def agreement(views: Sequence[View]) -> float:
    """Mean share of the masks' white, over views that have any, that their visual hull covers when it is projected."""
    hull = visual_hull(views, visible_box(views), views_used=len(views))
    shares = [share for view in views if (share := _covered(view, hull)) is not None]
    return float(np.mean(shares)) if shares and hull.views_used else 0.0


def _border(view: View) -> float:
    """Share of white among the pixels at the four edges."""
    mask = view.read_mask()[..., 0]
    return float(np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean())


def _covered(view: View, hull: Hull) -> float | None:
    """Share of the cells with white that the projected hull touches; None where the mask is empty."""
    from scipy.ndimage import binary_dilation

    camera = view.camera
    cell = max(camera.width, camera.height) / _GRID
    rows, columns = np.nonzero(view.read_mask()[..., 0] > 0.5)
    if not len(rows):
        return None
    shape = int(camera.height / cell) + 1, int(camera.width / cell) + 1
    white, touched = np.zeros(shape, bool), np.zeros(shape, bool)
    white[((rows + 0.5) / cell).astype(int), ((columns + 0.5) / cell).astype(int)] = True
    local = (hull.centres - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    pixels = camera.project(local[local[:, 2] > hull.radius])
    pixels = pixels[((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)]
    column, row = (pixels / cell).astype(int).T
    touched[row, column] = True
    return float((white & binary_dilation(touched, np.ones((3, 3)))).sum() / white.sum())
