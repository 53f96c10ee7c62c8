"""SIFT features and their matches between views.

Poses are not used for matching, so that matches are independent evidence for poses and bounds.
"""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.core.progress import Step, ignore
from koala3d.datasets.imaging import images, sift
from koala3d.datasets.scene import View

SIDE = 640
"""Longest side of the images in which features are detected [px]; it limits their accuracy."""
COUNT = 900
"""Features per view; the strongest are kept."""
RATIO = 0.8
"""A match must be this much nearer than the second best (Lowe 2004, section 7.1)."""
THREADS = min(os.cpu_count() or 1, 4)
"""Views that are searched at the same time."""
BLUR_PX = 2.0
"""Standard deviation of the window in which a feature's colour is measured [px of the image that is searched]."""


@dataclass(frozen=True, eq=False)
class ViewFeatures:
    """Features of one view."""

    directions: NDArray[np.float64]
    """(n, 3) rays in the camera's frame, z = 1."""
    descriptors: NDArray[np.float32]
    """(n, 128) unit vectors: the root of SIFT's, whose dot product is Hellinger's affinity."""
    colours: NDArray[np.float32]
    """(n, 3) linear light around each feature, 0..1; of the object alone where there is an alpha or a mask."""
    pixel: float
    """Size of a pixel of the image that was searched, as a tangent."""

    @property
    def light(self) -> NDArray[np.float32]:
        """(n,) mean of the colours' channels."""
        return self.colours.mean(-1)


@dataclass(frozen=True, eq=False)
class Matches:
    """Features of several views and their correspondences."""

    views: tuple[View, ...]
    features: tuple[ViewFeatures, ...]
    pairs: tuple[tuple[int, int, NDArray[np.int64]], ...]
    """(first view, second view, (k, 2) indices of their features)."""

    @property
    def count(self) -> int:
        """Number of matched pairs of features."""
        return sum(len(index) for _, _, index in self.pairs)


def matched(views: Sequence[View], pairs: Iterable[tuple[int, int]], *, side: int = SIDE, done: Step = ignore) -> Matches:
    """Features of all views, in images of at most `side` pixels, matched between the given pairs. `done` is called per view."""
    found = []
    with ThreadPoolExecutor(THREADS) as threads:
        for features in threads.map(lambda view: detect(view, side=side), views):
            found.append(features)
            done()
    return joined(views, found, pairs)


def joined(views: Sequence[View], found: Sequence["ViewFeatures"], pairs: Iterable[tuple[int, int]]) -> Matches:
    """Matches of views whose features are known, between the given pairs."""
    pairs = list(pairs)
    with ThreadPoolExecutor(THREADS) as threads:
        matches = threads.map(lambda pair: match(found[pair[0]], found[pair[1]]), pairs)
        kept = [(i, j, index) for (i, j), index in zip(pairs, matches, strict=True) if len(index)]
    return Matches(tuple(views), tuple(found), tuple(kept))


def detect(view: View, *, side: int = SIDE, count: int = COUNT) -> ViewFeatures:
    """Features of a view; with an alpha or a mask, only those of the object. Raises as `View.read` does."""
    return detect_in(view.read_small(side), view, count=count)


def detect_in(small: NDArray[np.float32], view: View, *, count: int = COUNT) -> ViewFeatures:
    """Features of a view in its picture at any size."""
    height, width = small.shape[:2]
    grey = 255 * small[..., :3].mean(-1)
    grey = np.where(np.isnan(grey), 0, grey).clip(0, 255).astype(np.uint8)  # NaN, as behind a mask, becomes black
    mask = np.uint8(255) * (small[..., 3] > 0.5) if small.shape[-1] == 4 else None
    found = sift.keypoints(grey, mask, count)
    directions = view.camera.scaled(width, height).directions(found.pixels)
    colours = _colours(small)[found.inside(width, height)]
    return ViewFeatures(directions, found.descriptors, colours, 1 / (view.camera.fx * width / view.camera.width))


def _colours(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """(height, width, 3) linear light of an sRGB picture, blurred; pixels count by their alpha."""
    import cv2

    light = images.linear_from_srgb(picture[..., :3])
    light = np.where(np.isfinite(light), light, np.float32(0))  # behind a mask there may be anything
    if picture.shape[-1] == 3:
        return np.asarray(cv2.GaussianBlur(light, (0, 0), BLUR_PX), np.float32)
    alpha = np.clip(picture[..., 3:], 0, 1)
    share = cv2.GaussianBlur(alpha, (0, 0), BLUR_PX)[..., None]
    return np.asarray(cv2.GaussianBlur(light * alpha, (0, 0), BLUR_PX) / np.maximum(share, 1e-3), np.float32)


def match(first: ViewFeatures, second: ViewFeatures) -> NDArray[np.int64]:
    """(k, 2) indices of features that are each other's best and clearly better than the second best."""
    if min(len(first.descriptors), len(second.descriptors)) < 2:
        return np.zeros((0, 2), np.int64)
    affinity = first.descriptors @ second.descriptors.T
    rows = np.arange(len(affinity))
    best = affinity.argmax(1)
    top = affinity[rows, best]
    affinity[rows, best] = -1.0
    second_best = affinity.max(1)
    affinity[rows, best] = top
    clear = np.flatnonzero(1 - top < RATIO**2 * (1 - second_best))  # squared distance of unit vectors is 2 - 2 * affinity
    chosen = clear[affinity[:, best[clear]].argmax(0) == clear]
    return np.stack([chosen, best[chosen]], axis=1)


def neighbours(
    world_from_camera: NDArray[np.float64], centre: NDArray[np.float64], *, count: int = 5, least_deg: float = 1.5
) -> list[tuple[int, int]]:
    """Pairs of (n, 4, 4) cameras that see `centre` from similar directions: each with its `count` nearest.

    Cameras less than `least_deg` apart, as seen from `centre`, have no parallax and are left out.
    """
    outward = world_from_camera[:, :3, 3] - centre
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    apart = np.rad2deg(np.arccos(np.clip(outward @ outward.T, -1, 1)))
    chosen: set[tuple[int, int]] = set()
    for i, angles in enumerate(apart):
        near = [int(j) for j in np.argsort(angles, kind="stable") if j != i and angles[j] >= least_deg][:count]
        chosen |= {(min(i, j), max(i, j)) for j in near}
    return sorted(chosen)


def pairs_of(world_from_camera: NDArray[np.float64], centre: NDArray[np.float64], *, count: int = 4) -> list[tuple[int, int]]:
    """Pairs of (n, 4, 4) cameras to be matched: `neighbours`, and the next two in the order of capture."""
    views = len(world_from_camera)
    in_order = [(i, i + step) for step in (1, 2) for i in range(views - step)]
    return sorted({*neighbours(world_from_camera, centre, count=count), *in_order})
