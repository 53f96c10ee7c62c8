"""Whether masks show the object in white or in black: told by the borders of the pictures, their middles, and the visual hull.

An object is in the middle of the pictures rather than at their borders, and its masks are the outlines of one body: what the
other views leave of space, projected into a view, covers the mask of that view and little else. What is around an object is no
such body: what lies beside the object in the other views may lie in front of it in this one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.splits import evenly
from koala3d.datasets.structure.bounds import Box, grid
from koala3d.datasets.structure.masks.silhouette import Silhouette
from koala3d.datasets.structure.masks.votes import needed

CLEAR_BORDER = 0.2
"""Share of white on the borders up to which white is the object without a further look."""
HULL_WEIGHT = 0.25
"""Weight of the hull against middle and border: an object that fills the pictures leaves too little around it to tell."""
CLEAR = 0.15
"""Evidence for black from which it is the object; without any, white is, as everywhere else."""
VIEWS = 12
"""Number of views whose masks are looked at."""
REACHED, MOSTLY, NEARLY_ALL = 0.1, 0.5, 0.9
"""White is all around if it has these shares of each edge and of the whole border, in this share of the pictures."""
BODY = 0.1
"""Agreement of the views on a body of black without which black beside the middles is no object."""
CELLS = 40
"""Cells along each side of the box."""


def inverted(masks: Sequence[Silhouette], box: Box) -> str:
    """Why black is the object in these masks, in a few words; empty where white is. The box is all that the cameras see."""
    white = evenly(masks, VIEWS)
    border = float(np.mean([border_white(mask.inside) for mask in white]))
    if border <= CLEAR_BORDER:
        return ""
    middle = float(np.mean([middle_white(mask.inside) for mask in white]))
    black = [replace(mask, inside=~mask.inside) for mask in white]
    of_white, of_black = agreement(white, box), agreement(black, box)
    if border - middle + HULL_WEIGHT * (of_black - of_white) < CLEAR or (middle > 0.5 and of_black < BODY):
        return ""
    hull = f"the views agree on a body of black by {of_black:.2f}, of white by {of_white:.2f}"
    return f"{border:.0%} of the borders are white, {middle:.0%} of the middles, and {hull}"


def of_surroundings(masks: Sequence[Silhouette]) -> bool:
    """Whether white is all that is seen and black a thing in the way, not the background of an object.

    White then reaches all four edges of nearly all pictures. An object hardly does: it would leave all of them on all sides.
    """
    reached = [min(edge.mean() for edge in edges_of(mask.inside)) > REACHED for mask in masks]
    mostly = [border_white(mask.inside) > MOSTLY for mask in masks]
    return float(np.mean(np.logical_and(reached, mostly))) > NEARLY_ALL


def edges_of(white: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], ...]:
    """The four edges of a mask."""
    return white[0], white[-1], white[:, 0], white[:, -1]


def border_white(white: NDArray[np.bool_]) -> float:
    """Share of white at the four edges of a mask."""
    return float(np.concatenate(edges_of(white)).mean())


def middle_white(white: NDArray[np.bool_]) -> float:
    """Share of white in the middle third of a mask's width and height."""
    rows, columns = white.shape
    return float(white[rows // 3 : rows - rows // 3, columns // 3 : columns - columns // 3].mean())


def agreement(silhouettes: Sequence[Silhouette], box: Box) -> float:
    """How well silhouettes are outlines of one body, from -1 to 1.

    Returns:
        Mean over the views of the share of a silhouette that the hull of the other views covers, less that of what is around it.
        The hull is what a third of the others see and leave to the object.
    """
    points, radius = grid(box, CELLS), float(np.linalg.norm(np.ptp(box, axis=0))) / CELLS / 2
    votes = [one.votes(points.T, radius) for one in silhouettes]
    seen, against = np.sum(votes, axis=0)
    found = []
    for one, (shown, empty) in zip(silhouettes, votes, strict=True):
        others = seen - shown
        left = (others >= max(len(silhouettes) // 3, 1)) & (against - empty < needed(others))
        covered, _ = one.covered(points[left], radius)
        if one.inside.any() and not one.inside.all():
            found.append(float(covered[one.inside].mean() - covered[~one.inside].mean()))
    return float(np.mean(found)) if found else 0.0
