"""Middles of the circles of a grid, to a hundredth of a pixel.

The middle of a circle's picture is not the picture of its middle: perspective and lens push it aside, by up to a pixel near a
large circle seen at an angle. A smooth map from the board to the picture (`calib.targets.plane_map`) is fitted to the middles
that were found; each is moved by how far the map shifts the centroid of its circle from the map of its middle.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Array, Indices
from koala3d.calib.targets import plane_map
from koala3d.calib.targets.plane_map import PlaneMap
from koala3d.datasets.targets.board import Board

RIM = 32  # points on the rim of a circle from which the centroid of its picture is computed
ROUNDS = 3
WHITE_RING = 0.5  # share of the gap between circles that still belongs to a circle's window


def find(board: Board, picture: NDArray[np.uint8]) -> tuple[Indices, NDArray[np.float32]] | None:
    """(n,) numbers and (n, 2) places of all circles, or None where they are not all seen."""
    asymmetric = board.kind == "asymmetric_circles"
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID if asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    columns, rows = board.squares_x, board.squares_y
    for clustering in (0, cv2.CALIB_CB_CLUSTERING):
        found, places = cv2.findCirclesGrid(
            picture, (columns, rows), flags=flags | clustering, blobDetector=_blobs(board, picture)
        )
        if found:
            break
    else:
        return None
    places = places.reshape(rows, columns, 2)
    if _is_mirrored(board, places):
        places = places[:, ::-1] if not asymmetric else places[::-1]
    return np.arange(rows * columns, dtype=np.int64), np.ascontiguousarray(places.reshape(-1, 2), np.float32)


def _blobs(board: Board, picture: NDArray[np.uint8]) -> cv2.SimpleBlobDetector:
    """OpenCV's detector of dark blobs, for circles of any size that a whole grid in the picture can have."""
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.minArea, parameters.maxArea = 12, picture.size / (board.squares_x * board.squares_y)
    parameters.minDistBetweenBlobs = 3
    parameters.filterByCircularity, parameters.minCircularity = True, 0.6
    parameters.minConvexity, parameters.minInertiaRatio = 0.85, 0.1
    return cv2.SimpleBlobDetector.create(parameters)


def _is_mirrored(board: Board, places: Array) -> bool:
    """Whether (rows, columns, 2) places run round the other way than on the board."""
    flat = cv2.findHomography(board.points[:, :2], places.reshape(-1, 2).astype(np.float64))[0]
    return bool(np.linalg.det(flat[:2, :2] - np.outer(flat[:2, 2], flat[2, :2]) / flat[2, 2]) * np.sign(flat[2, 2]) < 0)


def refined(board: Board, grey: NDArray[np.float32], found: NDArray[np.float32]) -> Array:
    """(n, 2) places of the circles' middles, from (n, 2) places near them; in OpenCV's pixel coordinates.

    NaN for circles whose surroundings are not all in the picture.

    Args:
        grey: (height, width) linear brightness.
    """
    middles = found.astype(np.float64)
    for _ in range(ROUNDS):
        measured = np.isfinite(middles).all(axis=1)
        if measured.sum() < plane_map.FEWEST:
            return np.full_like(middles, np.nan)
        to_picture = plane_map.fit(board.points[measured, :2], middles[measured], grey.shape[1], grey.shape[0])
        windows = _rims(board, to_picture, board.marker_length_m + 2 * WHITE_RING * _gap(board))
        centroids = np.array([_centroid(grey, window) for window in windows])
        shifts = np.array([_polygon_centroid(rim) for rim in _rims(board, to_picture, board.marker_length_m)])
        middles = centroids - (shifts - to_picture(board.points[:, :2]))
    return middles


def _gap(board: Board) -> float:
    """Width of the white between neighbouring circles [m]."""
    apart = np.sqrt(2) if board.kind == "asymmetric_circles" else 1.0
    return float(apart * board.square_length_m - board.marker_length_m) / 2


def _rims(board: Board, to_picture: PlaneMap, diameter: float) -> Array:
    """(n, RIM, 2) places in the picture of circles of a diameter about the middles [px]."""
    turn = 2 * np.pi * np.arange(RIM) / RIM
    rim = diameter / 2 * np.stack([np.cos(turn), np.sin(turn)], -1)
    return to_picture((board.points[:, None, :2] + rim).reshape(-1, 2)).reshape(-1, RIM, 2)


def _polygon_centroid(rim: Array) -> Array:
    """(2,) centroid of the area inside a polygon of (m, 2) corners."""
    origin = rim.mean(axis=0)
    a, b = rim - origin, np.roll(rim, -1, axis=0) - origin
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.asarray(origin + ((a + b) * cross[:, None]).sum(axis=0) / (3 * cross.sum()), np.float64)


def _centroid(grey: NDArray[np.float32], window: Array) -> Array:
    """(2,) centroid of the darkness inside a polygon of (m, 2) corners; NaN where the picture does not hold it.

    Darkness is the share of light that is missing, so that it does not depend on uneven light. White is a plane through the
    brightness of the rim: darkness vanishes there, and where pixels are cut off does not matter.
    """
    low, high = np.floor(window.min(axis=0)).astype(int), np.ceil(window.max(axis=0)).astype(int) + 1
    height, width = grey.shape
    if (low < 0).any() or high[0] > width or high[1] > height:
        return np.full(2, np.nan)
    middle = window.mean(axis=0)
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    inside = np.zeros(part.shape, np.uint8)
    cv2.fillPoly(inside, [np.rint(16 * (window - low)).astype(np.int32)], 1, shift=4)
    places = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), -1)[inside > 0].astype(np.float64)
    rim = cv2.remap(grey, window[None].astype(np.float32), None, cv2.INTER_LINEAR).ravel().astype(np.float64)
    plane = np.linalg.lstsq(np.column_stack([window - middle, np.ones(len(window))]), rim, rcond=None)[0]
    white = np.column_stack([places - middle, np.ones(len(places))]) @ plane
    if not white.min() > 0:
        return np.full(2, np.nan)
    dark = 1 - part[inside > 0] / white
    if not dark.sum() > 0:
        return np.full(2, np.nan)
    return np.asarray((places * dark[:, None]).sum(axis=0) / dark.sum(), np.float64)
