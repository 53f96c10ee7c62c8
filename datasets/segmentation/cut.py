"""One small picture divided into object and background, from where the object is expected and what a person drew."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

CERTAIN, LIKELY, POSSIBLE = 0.95, 0.6, 0.3
"""Expectation above which a pixel is the object's, above which it begins as such, and above which it may become so."""
ITERATIONS = 2
FEWEST = 20
"""Pixels of either side that a model of its colours needs."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """(height, width) pixels on which strokes lie."""

    object: NDArray[np.bool_]
    background: NDArray[np.bool_]


def cut(picture: NDArray[np.uint8], expected: NDArray[np.float32], drawn: Drawn) -> NDArray[np.bool_]:
    """(height, width) pixels of the object, by GrabCut (Rother, Kolmogorov and Blake 2004).

    Args:
        picture: (height, width, 3) sRGB.
        expected: (height, width) how much the object is expected in each pixel, 0 to 1.
        drawn: what strokes say; it is kept.
    """
    labels = np.full(expected.shape, cv2.GC_BGD, np.uint8)
    labels[expected > POSSIBLE] = cv2.GC_PR_BGD
    labels[expected > LIKELY] = cv2.GC_PR_FGD
    labels[expected > CERTAIN] = cv2.GC_FGD
    labels[drawn.object] = cv2.GC_FGD
    labels[drawn.background] = cv2.GC_BGD
    begun = _of_object(labels)
    if min(begun.sum(), (~begun).sum()) < FEWEST or not (labels == cv2.GC_BGD).any():
        return begun
    cv2.setRNGSeed(0)  # GrabCut's colour models begin at random
    models = np.zeros((2, 1, 65))
    cv2.grabCut(picture, labels, (0, 0, 0, 0), models[0], models[1], ITERATIONS, cv2.GC_INIT_WITH_MASK)
    return _of_object(labels)


def _of_object(labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
