"""Each mask against the space that the other masks agree on.

A coarse grid in the object's box keeps what all but a few masks allow: a visual hull that a single wrong mask cannot carve. Its
silhouette in a view and that view's mask run side by side; where a mask is shifted, eroded or dilated, they do not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.checks.evidence import OUTSTANDING, Evidence
from koala3d.datasets.core.findings import Finding
from koala3d.datasets.structure import bounds
from koala3d.datasets.structure.masks.silhouette import PIXELS_APART, Sight, Silhouette, distance_to
from koala3d.datasets.structure.masks.votes import BLOCK, carved

CELLS = 144
"""Cells of the grid along the box's longest side."""
VETOES = 0.13
"""Share of the views that rule a cell out. They vote on its centre, not on all of it:
a safe bound would be a blunt outline."""
RARE = 3.91 / 1.177
"""Median lengths of a shift, which has two directions, from which it is as rare as `OUTSTANDING` deviations of one figure."""
LEAST_PX, LEAST_CELLS = 2.5, 1.1
"""Shift or growth of a mask from which it is reported [px of the image that was searched], and the same in cells of the hull."""
EXCESS = 0.1
"""Weight of an outline inside the silhouette against one outside: a hull is larger than the object where no view cuts into it, so
that the tight parts of the outline decide."""
CUT, MARGIN = 0.05, 6
"""Share of the picture's border inside a mask from which it is not judged, and distance from the border within which its outline
does not count: the object goes on outside."""
ALL_AROUND = 0.12
"""Least mean square of the outline's normals along any direction: else a shift along the outline would not be seen."""
FEWEST = 60
"""Pixels of a mask's outline with which it is judged."""


@dataclass(frozen=True)
class Outline:
    """How a mask's outline lies against the hull's silhouette."""

    inward_px: float
    """How far the outline lies inside the silhouette: positive for an eroded mask."""
    shift_px: tuple[float, float]
    """How far the mask is shifted, right and down."""
    cell_px: float
    """Side of the hull's cells in this view: what is much smaller cannot be seen."""


def find(evidence: Evidence) -> list[Finding]:
    """One finding per view whose mask does not fit the others."""
    if any(picture.shape[-1] != 4 for picture in evidence.pictures) or len(evidence.views) < 6:
        return []
    if all((picture[..., 3] > 0.5).all() for picture in evidence.pictures):
        return []
    cells, radius = hull(evidence)
    if len(cells) < 100:
        return []
    outlines = [outline(evidence, view, cells, radius) for view in range(len(evidence.views))]
    grown = np.array([np.nan if one is None else one.inward_px for one in outlines])
    moved = np.array([(np.nan, np.nan) if one is None else one.shift_px for one in outlines])
    if not np.isfinite(grown).any():
        return []
    grown -= np.nanmedian(grown)
    moved -= np.nanmedian(moved, axis=0)
    length = np.linalg.norm(moved, axis=1)
    least = np.array([np.inf if one is None else max(LEAST_PX, LEAST_CELLS * one.cell_px) for one in outlines])
    eroded = _outstanding(np.abs(grown), least, 1.4826 * OUTSTANDING)
    shifted = _outstanding(length, least, RARE)
    found = []
    for view in np.flatnonzero(eroded | shifted):
        name = evidence.views[view].name
        words = "shifted by ({:+.1f}, {:+.1f}) px".format(*moved[view]) if shifted[view] else ""
        size = f"{'smaller' if grown[view] > 0 else 'larger'} by {abs(grown[view]):.1f} px" if eroded[view] else ""
        why = f"it is {' and '.join(filter(None, (words, size)))} against what the other masks agree on"
        figures = {"views": {name: {"smaller_px": float(grown[view]), "shift_px": moved[view].tolist()}}}
        remedy = "correct the mask, or drop the view: training takes what it hides for empty"
        found.append(Finding("warning", "mask does not fit the others", f"view {name}", why, remedy, "mask", figures))
    return found


def _outstanding(size: NDArray[np.float64], least: NDArray[np.float64], medians: float) -> NDArray[np.bool_]:
    known = size[np.isfinite(size)]
    return size > np.maximum(least, medians * float(np.median(known)))


def hull(evidence: Evidence) -> tuple[NDArray[np.float64], float]:
    """(n, 3) centres of the cells that nearly all masks allow, and half a cell's side."""
    low, high = evidence.scene.box
    margin = 0.05 * (high - low).max()
    low, high = low - margin, high + margin
    cell = float((high - low).max()) / CELLS
    counts = BLOCK * np.ceil((high - low) / (BLOCK * cell)).astype(int)
    box = np.stack([low, low + cell * counts])
    silhouettes = [Silhouette(*_camera(evidence, view), picture[..., 3] > 0.5) for view, picture in enumerate(evidence.pictures)]
    kept = carved(silhouettes, box, counts, seen_by=max(3, len(silhouettes) // 3), share=VETOES, centres=True)
    return bounds.grid(box, counts)[kept], cell / 2


def _camera(evidence: Evidence, view: int) -> tuple[Camera, NDArray[np.float64]]:
    """Camera of a view's small picture, and its pose."""
    height, width = evidence.pictures[view].shape[:2]
    return evidence.views[view].camera.scaled(width, height), evidence.matrices[view]


def cut(mask: NDArray) -> bool:
    """Whether the object goes on beyond the picture, so that its (height, width) mask is not judged."""
    return bool(np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean() > CUT)


def outline(evidence: Evidence, view: int, cells: NDArray[np.float64], radius: float) -> Outline | None:
    """Fit of a mask's outline to the hull's silhouette; None where too little of it is in the picture."""
    import cv2

    mask = np.ascontiguousarray(evidence.pictures[view][..., 3] > 0.5).astype(np.uint8)
    silhouette, reach = Sight(*_camera(evidence, view)).covered(cells, radius)
    edge = cv2.morphologyEx(mask, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)).astype(bool)
    edge[:MARGIN] = edge[-MARGIN:] = edge[:, :MARGIN] = edge[:, -MARGIN:] = False
    rows, columns = np.nonzero(edge)
    if len(rows) < FEWEST or cut(mask) or not silhouette.any() or silhouette.all():
        return None
    within = distance_to(~silhouette) - distance_to(silhouette) - reach
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 3)
    outward = -np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=-1)[rows, columns]
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
    if np.linalg.eigvalsh(outward.T @ outward / len(outward))[0] < ALL_AROUND:
        return None
    design, target = np.concatenate([np.ones((len(rows), 1)), -outward], axis=1), within[rows, columns]
    solution, weight = np.zeros(3), np.ones(len(rows))
    for width in (20.0, 8.0, 4.0, 4.0, 4.0, 4.0):
        weighted = design * weight[:, None]
        solution = np.linalg.solve(design.T @ weighted + 1e-6 * np.eye(3), weighted.T @ target)
        residual = target - design @ solution
        weight = np.where(residual > 0, EXCESS, 1 - EXCESS) / (1 + (residual / width) ** 2) ** 2
    return Outline(float(solution[0]), (float(solution[1]), float(solution[2])), 2 * (reach - PIXELS_APART))
