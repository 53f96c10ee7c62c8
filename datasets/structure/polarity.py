"""Whether masks show the object in white or in black: told by the borders of the pictures, their middles, and the visual hull.

An object is in the middle of the pictures rather than at their borders, and its masks are the outlines of one body: what the
other views leave of space, projected into a view, covers the mask of that view and little else. What is around an object is no
such body: what lies beside the object in the other views may lie in front of it in this one.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.imaging import images
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import View
from koala3d.datasets.splits import evenly
from koala3d.datasets.structure.bounds import grid, visible_box

CLEAR_BORDER = 0.2
"""Share of white on the borders up to which white is the object without a further look."""
HULL_WEIGHT = 0.25
"""Weight of the hull against middle and border: an object that fills the pictures leaves too little around it to tell."""
CLEAR = 0.15
"""Evidence for black from which it is the object; without any, white is, as everywhere else."""
VIEWS = 12
"""Number of views whose masks are read."""
_CELLS, _VOXELS = 48, 40
"""Cells of a mask's longer side, and voxels of the box's side: about as large in the middle of the box."""
_PURE = 0.02
"""Share of the other colour up to which a cell is white or black."""


def inverted(views: Sequence[View]) -> str:
    """Why black is the object in these masks, in a few words; empty where white is. The views must all have masks."""
    chosen = evenly(views, VIEWS)
    cells = list(streamed(_cells, chosen, workers=READERS))
    border = float(np.mean([border_white(cell) for cell in cells]))
    if border <= CLEAR_BORDER:
        return ""
    places = [_places(view, cell.shape, visible_box(chosen)) for view, cell in zip(chosen, cells, strict=True)]
    middle = float(np.mean([middle_white(cell) for cell in cells]))
    white, black = agreement(cells, places), agreement([1 - cell for cell in cells], places)
    if border - middle + HULL_WEIGHT * (black - white) < CLEAR:
        return ""
    hull = f"the views agree on a body of black by {black:.2f}, of white by {white:.2f}"
    return f"{border:.0%} of the borders are white, {middle:.0%} of the middles, and {hull}"


def border_white(cells: NDArray[np.float32]) -> float:
    """Share of white at the four edges of a mask."""
    return float(np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]]).mean())


def middle_white(cells: NDArray[np.float32]) -> float:
    """Share of white in the middle third of a mask's width and height."""
    rows, columns = cells.shape
    return float(cells[rows // 3 : rows - rows // 3, columns // 3 : columns - columns // 3].mean())


def agreement(cells: Sequence[NDArray[np.float32]], places: Sequence[NDArray[np.int64]]) -> float:
    """How well the masks are outlines of one body, from -1 to 1.

    Args:
        cells: (rows, columns) share of white in each cell of a mask, per view.
        places: (n,) flat index of the cell in which a view sees each point of space, -1 outside its picture; per view.

    Returns:
        Mean over the views of the share of white cells that the hull of the other views covers, less that of the black cells.
        The hull is what a third of the others see and at most one of them excludes.
    """
    from scipy.ndimage import binary_dilation

    around = np.ones((3, 3))
    seen = np.stack([place >= 0 for place in places])
    outside = [np.logical_not(binary_dilation(cell > _PURE, around)).ravel() for cell in cells]
    excluded = seen & np.stack([mask[place] for mask, place in zip(outside, places, strict=True)])
    found = []
    for number, (cell, place) in enumerate(zip(cells, places, strict=True)):
        kept = (seen.sum(0) - seen[number] >= max(len(cells) // 3, 1)) & (excluded.sum(0) - excluded[number] <= 1)
        covered = np.zeros(cell.size, bool)
        covered[place[kept & seen[number]]] = True
        touched = binary_dilation(covered.reshape(cell.shape), around)
        white, black = cell > 1 - _PURE, cell < _PURE
        if white.any() and black.any():
            found.append(float(touched[white].mean() - touched[black].mean()))
    return float(np.mean(found)) if found else 0.0


def _cells(view: View) -> NDArray[np.float32]:
    """(rows, columns) share of white in each cell of a view's mask."""
    scale = _CELLS / max(view.camera.width, view.camera.height)
    size = max(round(view.camera.width * scale), 2), max(round(view.camera.height * scale), 2)
    return images.resize(view.read_mask(), *size, srgb=False)[..., 0]


def _places(view: View, shape: tuple[int, ...], box: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) flat index of the cell in which a view sees each voxel of a box; -1 outside its picture."""
    points = grid(box, _VOXELS)
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    front = local[:, 2] > 0
    camera = view.camera
    pixels = camera.project(np.where(front[:, None], local, [0.0, 0.0, 1.0]))
    inside = front & ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
    column, row = (np.where(inside[:, None], pixels, 0) * [shape[1] / camera.width, shape[0] / camera.height]).astype(int).T
    return np.where(inside, row * shape[1] + column, -1)
