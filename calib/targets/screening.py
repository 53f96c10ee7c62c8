"""Wrong corners: those that no flat target shows, and those that differ from the corners around them."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from koala3d.calib.arrays import Array, Mask
from koala3d.calib.targets.detection import MIN_CORNERS, Observation

TOLERANCE = 1.0  # largest distance from a homography that a lens may cause, in units of the distance between neighbouring corners
BENT_SHARE = 0.1  # if more than half of the views would lose more than this share of their corners, the lens is the reason
MIN_SHARE = 0.5  # a view is left out if a smaller share of its corners agrees with a homography
NEIGHBOURS = 12  # corners of which the median is taken: up to five of them may be wrong


def from_neighbours(pixels: Array, residuals: Array) -> Array:
    """(n,) distances of (n, 2) residuals from the median of the corners nearest in the image, in whatever view [px].

    What a lens model leaves is alike there, and a wrong corner stands alone.
    """
    nearest = cKDTree(pixels).query(pixels, min(NEIGHBOURS, len(pixels)))[1].reshape(len(pixels), -1)
    return np.linalg.norm(residuals - np.median(residuals[nearest], axis=1), axis=1)


def some(observation: Observation, chosen: Mask) -> Observation:
    """The corners of `chosen` (n,) alone."""
    return replace(observation, ids=observation.ids[chosen], pixels=observation.pixels[chosen], points=observation.points[chosen])


def agreeing_with_plane(observations: Sequence[Observation]) -> tuple[list[Observation], dict[str, str]]:
    """Observations without corners far from where a flat target could show them, and the views left out, with the reason.

    A homography is found from the majority of a view's corners (RANSAC); the lens bends its picture by much less than the
    distance between two corners, a wrong detection is off by about that and more.
    """
    agree = [_on_plane(observation) for observation in observations]
    if np.mean([good.mean() < 1 - BENT_SHARE for good in agree]) > 0.5:
        return list(observations), {}
    kept, left_out = [], {}
    for observation, good in zip(observations, agree, strict=True):
        if good.sum() < max(min(MIN_CORNERS, len(good)), MIN_SHARE * len(good)):
            left_out[observation.name] = f"{(~good).sum()} of {len(good)} corners do not lie on a flat target"
        else:
            kept.append(some(observation, good))
    return kept, left_out


def _on_plane(observation: Observation) -> Mask:
    """(n,) corners that the best homography explains."""
    limit = max(TOLERANCE * _spacing(observation), 1.0)
    cv2.setRNGSeed(0)  # RANSAC draws from OpenCV's own generator: the same views give the same answer
    try:
        _, mask = cv2.findHomography(observation.points[:, :2], observation.pixels, cv2.RANSAC, limit, maxIters=500)
    except cv2.error:
        mask = None
    return np.zeros(len(observation.ids), bool) if mask is None else mask.ravel().astype(bool)


def _spacing(observation: Observation) -> float:
    """Typical distance between neighbouring corners [px]."""
    difference = observation.pixels[:, None] - observation.pixels
    distance = np.linalg.norm(difference, axis=-1) + np.diag(np.full(len(difference), np.inf))
    return float(np.median(distance.min(1)))
