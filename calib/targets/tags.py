"""Corners of tags, of a plain grid or of Kalibr's AprilGrid."""

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Indices
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import dictionary_of

WIDENED_PX = (0, 1, 2, 3)
"""By how much white is widened to part tags from the squares that touch them: of an AprilGrid each is tried."""


def find(board: Board, picture: NDArray[np.uint8]) -> tuple[Indices, NDArray[np.float32]] | None:
    """(n,) corner numbers and (n, 2) places of the tags in a picture, to a pixel or two; None where there is none.

    A picture with two tags of one number shows another target, or a reflection: None.
    """
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.markerBorderBits = board.border_bits
    detector = cv2.aruco.ArucoDetector(dictionary_of(board), parameters)
    tags: dict[int, NDArray[np.float32]] = {}
    for widened in WIDENED_PX if board.kind == "aprilgrid" else WIDENED_PX[:1]:
        kernel = np.ones((2 * widened + 1,) * 2, np.uint8)
        quads, ids, _ = detector.detectMarkers(cv2.dilate(picture, kernel) if widened else picture)
        numbers = (np.zeros(0, np.int64) if ids is None else ids.ravel().astype(np.int64)) - board.first_id
        good = (numbers >= 0) & (numbers < board.squares_x * board.squares_y)
        if len(set(numbers[good])) < good.sum():
            return None
        for i in np.flatnonzero(good):
            tags.setdefault(int(numbers[i]), _grown(quads[i].reshape(4, 2), widened))
    if not tags:
        return None
    found = sorted(tags)
    corner = (4 * np.array(found)[:, None] + np.arange(4)).ravel()
    return corner.astype(np.int64), np.concatenate([tags[number] for number in found]).astype(np.float32)


def _grown(quad: NDArray[np.float32], by: int) -> NDArray[np.float32]:
    """(4, 2) corners moved outwards by about so many pixels along both axes of the picture."""
    outwards = quad - quad.mean(axis=0)
    return quad + by * np.sqrt(2) * outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
