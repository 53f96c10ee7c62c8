"""How much of an object is matte, from its pictures alone: places that keep their position and their colour from view to view.

A matched feature is a place of the object if its rays meet inside the object's box, and matte if two views see it in the same
light. Reflections move over the surface, change with the view, or meet behind a flat mirror; smooth surfaces have no features.
"""

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.structure.matching import SIDE, Matches, ViewFeatures
from koala3d.datasets.structure.triangulate import meeting_places

ALIKE = 0.1
"""Largest difference of logarithmic light between two views that see the same place in the same colour."""
DARK = 0.01
"""Added to linear light before its logarithm is taken: noise and black level."""
MARGIN = 0.1
"""By how much of its size the box is widened: where rays meet is uncertain along them."""
NEAR = 0.05
"""Distance from a matte place within which a pixel counts as matte, as a share of the object's size in the picture."""
PICTURES = 15
"""Pictures in which the object's pixels are counted, at most."""


def matte_share(matches: Matches, box: NDArray[np.float64], side: int = SIDE) -> float | None:
    """Mean share of the object's pixels that are near a matte place, 0..1; None where pictures have no alpha.

    Args:
        matches: with the poses of their views.
        box: (2, 3) corners of the object's box.
        side: longest side of the pictures that were matched [px].
    """
    kept = matte_features(matches, box)
    chosen = np.unique(np.linspace(0, len(matches.views) - 1, PICTURES).round().astype(int))
    shares = []
    for index in chosen:
        view, picture = matches.views[index], matches.views[index].read_small(side)
        if picture.shape[-1] != 4:
            return None
        height, width = picture.shape[:2]
        places = view.camera.scaled(width, height).project(matches.features[index].directions[kept[index]])
        if (inside := picture[..., 3] > 0.5).any():
            shares.append(_near(inside, places))
    return float(np.mean(shares)) if shares else None


def matte_features(matches: Matches, box: NDArray[np.float64]) -> list[NDArray[np.bool_]]:
    """For each view, which of its features another view sees at the same place of the box in the same light, exposure apart."""
    low, high = box + MARGIN * (box[1] - box[0]) * np.array([[-1.0], [1.0]])
    poses = np.stack([view.world_from_camera for view in matches.views])
    kept = [np.zeros(len(features.directions), bool) for features in matches.features]
    for pair in matches.pairs:
        i, j, index = pair
        agreed, places = meeting_places(matches, pair, poses)
        same = index[agreed & np.all((low <= places) & (places <= high), -1)]
        if not len(same):
            continue
        ratio = _log_light(matches.features[i], same[:, 0]) - _log_light(matches.features[j], same[:, 1])
        alike = same[np.abs(ratio - np.median(ratio)) < ALIKE]
        kept[i][alike[:, 0]] = kept[j][alike[:, 1]] = True
    return kept


def _log_light(features: ViewFeatures, index: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.log(features.light[index].astype(np.float64) + DARK)


def _near(inside: NDArray[np.bool_], places: NDArray[np.float64]) -> float:
    """Share of the pixels inside that are near a place; (height, width) and (n, 2)."""
    import cv2

    height, width = inside.shape
    apart = np.ones(inside.shape, np.uint8)
    column, row = np.clip(places.astype(int), 0, [width - 1, height - 1]).T
    apart[row, column] = 0
    if apart.all():
        return 0.0
    distance = cv2.distanceTransform(apart, cv2.DIST_L2, 5)
    return float(np.mean(distance[inside] < NEAR * np.sqrt(inside.sum())))
