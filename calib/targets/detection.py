"""Finds a calibration target in a picture: corners of ChArUco boards, chessboards and tags, middles of circles."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Array, Indices
from koala3d.calib.errors import TargetError
from koala3d.calib.targets import circles, corners, tags
from koala3d.datasets import conventions
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.core.schema import validate
from koala3d.datasets.imaging.images import linear_from_srgb
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import dictionary_of

SEARCHED = (1500, 3000)  # longest sides at which a chessboard is looked for [px]: none in 24 megapixels took 16 s at full size
MIN_CORNERS = 8  # a view of a checkered target with fewer corners is left out; of tags, one whole tag will do
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
Detected = tuple[Indices, NDArray[np.float32]] | None
"""(n,) corner numbers and (n, 2) places in OpenCV's pixel coordinates; None: no target."""


@dataclass(frozen=True)
class Observation:
    """Corners of a target in one view."""

    name: str
    ids: Indices  # (n,) corner numbers
    pixels: Array  # (n, 2) where they are seen, first pixel's centre at (0.5, 0.5) [px]
    points: Array  # (n, 3) where they are on the board, board frame [m]


def read_board(content: Any, *, where: object) -> Board:
    """The board that a recording's manifest describes under `board`. Unknown keys are ignored. Raises TargetError."""
    if not isinstance(content, dict):
        remedy = "record a target session, for instance with --scene board"
        raise TargetError("recording describes no calibration target", where=where, remedy=remedy)
    known = {k: v for k, v in content.items() if k in (*Board.model_fields, "type") and v is not None}
    try:
        board = validate(known, Board, where=where)
    except UsageError as error:
        raise TargetError(error.what, where=error.where, why=error.why, remedy=error.remedy) from None
    return check_markers(board, where=where)


def check_markers(board: Board, *, where: object) -> Board:
    """`board` as given. Raises TargetError if OpenCV lacks its marker dictionary, or the dictionary has too few markers."""
    if not board.has_markers:
        return board
    names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    if board.dictionary not in names:
        remedy = nearest(board.dictionary, names)
        raise TargetError("unknown marker dictionary", where=where, why=repr(board.dictionary), remedy=remedy)
    squares, available = board.squares_x * board.squares_y, len(dictionary_of(board).bytesList)
    needed = board.first_id + squares if board.has_tags else squares // 2
    if needed > available:
        why = f"{needed} markers are needed, {board.dictionary} has {available}"
        raise TargetError("marker dictionary is too small", where=where, why=why, remedy="choose a larger dictionary")
    return board


def detect(board: Board, grey: NDArray[np.float32], name: str) -> Observation | None:
    """Find the target in a picture.

    Args:
        grey: (height, width) brightness, sRGB 0..1.

    Returns:
        The corners, or None where fewer than `MIN_CORNERS` are seen or all of them lie on one line.
    """
    picture = np.ascontiguousarray(np.rint(np.clip(grey, 0, 1) * 255), np.uint8)
    search = {"charuco": _charuco_corners, "chessboard": _chessboard_corners}
    search |= {"tags": tags.find, "aprilgrid": tags.find, "circles": circles.find, "asymmetric_circles": circles.find}
    found = search[board.kind](board, picture)
    if found is None or len(found[0]) < (4 if board.has_tags else MIN_CORNERS):
        return None
    ids, places = found
    points = board.points[ids]
    if np.linalg.matrix_rank(points - points.mean(0), tol=1e-9) < 2:
        return None
    light = np.ascontiguousarray(grey, np.float32)
    if board.has_circles:
        exact = circles.refined(board, linear_from_srgb(light), places)
    else:
        exact = _refined(board, light, ids, places)
    good = np.isfinite(exact).all(axis=1)
    if not good.any():
        return None
    return Observation(name, ids[good], conventions.pixels_from_opencv(exact[good]), points[good])


def _charuco_corners(board: Board, picture: NDArray[np.uint8]) -> Detected:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    size, lengths = (board.squares_x, board.squares_y), (board.square_length_m, board.marker_length_m)
    pattern = cv2.aruco.CharucoBoard(size, *lengths, dictionary_of(board))
    pattern.setLegacyPattern(board.legacy_pattern)
    detector = cv2.aruco.CharucoDetector(pattern, cv2.aruco.CharucoParameters(), parameters)
    places, ids, _, _ = detector.detectBoard(picture)
    if ids is None or len(ids) == 0:
        return None
    return ids.reshape(-1).astype(np.int64), places.reshape(-1, 2).astype(np.float32)


def _chessboard_corners(board: Board, picture: NDArray[np.uint8]) -> Detected:
    columns, rows = board.squares_x - 1, board.squares_y - 1
    sides = dict.fromkeys(min(side, max(picture.shape)) for side in SEARCHED)
    found = (_chessboard_in(picture, side, (columns, rows)) for side in sides)
    places = next((places for places in found if places is not None), None)
    if places is None:
        return None
    if (not board.is_ambiguous or rows == columns) and not _first_square_is_dark(picture, places):
        places = np.rot90(places) if rows == columns else places[::-1, ::-1]
    return np.arange(rows * columns, dtype=np.int64), np.ascontiguousarray(places.reshape(-1, 2))


def _chessboard_in(picture: NDArray[np.uint8], side: int, size: tuple[int, int]) -> NDArray[np.float32] | None:
    """(rows, columns, 2) corners, in pixels of the picture, that are found at no more than `side` pixels a side."""
    shrink = max(max(picture.shape) / side, 1.0)
    small = picture if shrink == 1 else cv2.resize(picture, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    ratio = np.array(picture.shape[::-1]) / small.shape[::-1]
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, places = cv2.findChessboardCorners(small, size, flags=flags)
    if not found:
        return None
    return ((places.reshape(*size[::-1], 2) + 0.5) * ratio - 0.5).astype(np.float32)


def _refined(board: Board, grey: NDArray[np.float32], ids: Indices, found: NDArray[np.float32]) -> Array:
    """(n, 2) corners to a few hundredths of a pixel: `cornerSubPix` brings them near, a fit of the picture there.

    NaN for those of an AprilGrid that could not be fitted.
    """
    points, clear_m = board.points[ids, :2], _clear_m(board)
    metres, pixels = np.linalg.norm(points[:, None] - points, axis=-1), np.linalg.norm(found[:, None] - found, axis=-1)
    neighbours = (metres > 0) & (metres < 1.01 * (board.marker_length_m if board.has_tags else board.square_length_m))
    scale = np.percentile(pixels[neighbours] / metres[neighbours], 10) if neighbours.any() else 0.0
    half = int(np.clip(0.8 * scale * clear_m / np.sqrt(2), 2, 10))
    near = cv2.cornerSubPix(grey, found.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), _SUBPIXEL).reshape(-1, 2)
    inwards = None
    if board.kind == "tags":  # an edge in encoded brightness lies on the dark side of its place; at other corners this cancels
        inwards, grey = -np.sign(points - board.centres[ids // 4]), linear_from_srgb(grey)
    or_start = board.kind != "aprilgrid"  # its tags are found among squares that touch them, a pixel or two off
    return corners.fit(grey, near.astype(np.float64), points, 0.9 * clear_m, inwards, or_start=or_start)


def _clear_m(board: Board) -> float:
    """Radius around a corner in which only its own two edges are seen: to the nearest marker, cell or corner [m]."""
    margin = board.square_length_m - board.marker_length_m
    if board.has_tags:
        cell = board.marker_length_m / (dictionary_of(board).markerSize + 2 * board.border_bits)
        return min(board.border_bits * cell, margin or np.inf)
    return margin / np.sqrt(2) if board.kind == "charuco" else board.square_length_m / 2


def _first_square_is_dark(picture: NDArray[np.uint8], places: NDArray[np.float32]) -> bool:
    """Whether the square between the corners (0, 0) and (1, 1) is darker than its right neighbour.

    That square touches the board's first one, which is dark, at a corner.
    """

    def brightness(row: int, column: int) -> float:
        x, y = places[row : row + 2, column : column + 2].reshape(-1, 2).mean(0)
        return float(cv2.getRectSubPix(picture, (3, 3), (float(x), float(y))).mean())

    return brightness(0, 0) < brightness(0, 1)
