"""SIFT: places in a picture that can be found again in other pictures, and their descriptors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets import conventions

PEAK = 0.02
"""Least contrast of a feature, times the number of layers per octave."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Places in one picture."""

    pixels: NDArray[np.float64]
    """(n, 2) in our convention."""
    descriptors: NDArray[np.float32]
    """(n, 128) roots of the histograms divided by their sums: unit vectors (Arandjelović and Zisserman 2012)."""
    contrast: NDArray[np.float32]
    """(n,) how much each differs from what is around it."""

    def inside(self, width: int, height: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(n,) rows and columns of the pixels that hold them, in a picture of this size."""
        column, row = np.minimum(self.pixels.astype(np.int64), [width - 1, height - 1]).T
        return row, column


def keypoints(grey: NDArray[np.uint8], mask: NDArray[np.uint8] | None, count: int) -> Keypoints:
    """The `count` places of the highest contrast in a (height, width) picture, if there is a mask only where it is white."""
    import cv2

    sift = cv2.SIFT.create(count, 3, PEAK, 10.0, 1.6, cv2.CV_32F, True)  # True: no bias of a quarter of a pixel
    found, histograms = sift.detectAndCompute(grey, mask)
    if histograms is None:
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0, np.float32))
    root = np.sqrt(histograms / np.maximum(histograms.sum(1, keepdims=True), 1e-12))
    contrast = np.array([point.response for point in found], np.float32)
    return Keypoints(conventions.pixels_from_opencv([point.pt for point in found]), root.astype(np.float32), contrast)
