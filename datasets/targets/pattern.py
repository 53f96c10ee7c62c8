"""What is printed on a calibration target: dark rectangles and circles, for the printer; or light and dark at any place.

Both say the same. Lengths in metres, board frame.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.targets.board import Board

Array = NDArray[np.float64]


def dictionary_of(board: Board) -> cv2.aruco.Dictionary:
    """OpenCV's marker dictionary of a board."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))


@dataclass(frozen=True)
class Pattern:
    """The print of a board whose dictionary exists and is large enough."""

    board: Board

    @cached_property
    def rectangles(self) -> Array:
        """(n, 4) x, y, width, height of all dark rectangles: squares, cells of markers, and what lies between tags."""
        board, side = self.board, self.board.square_length_m
        found = [(x * side, y * side, side, side) for x, y in self._squares if board.is_checkered and self._is_dark(x, y)]
        margin = (side - board.marker_length_m) / 2
        for (x, y), cells in self._markers.items():
            found += _runs(cells, x * side + margin, y * side + margin, board.marker_length_m / len(cells))
        if board.kind == "aprilgrid":
            corners = [(x * side, y * side) for y in range(board.squares_y + 1) for x in range(board.squares_x + 1)]
            found += [(x - margin, y - margin, 2 * margin, 2 * margin) for x, y in corners]
        return np.array(found, np.float64).reshape(-1, 4)

    @cached_property
    def circles(self) -> Array:
        """(n, 3) middle and diameter of all dark circles."""
        centres = self.board.centres if self.board.has_circles else np.zeros((0, 2))
        return np.column_stack([centres, np.full(len(centres), self.board.marker_length_m)])

    @property
    def overhang(self) -> float:
        """How far the print reaches beyond the outer squares."""
        board = self.board
        return (board.square_length_m - board.marker_length_m) / 2 if board.kind == "aprilgrid" else 0.0

    def whiteness(self, places: Array) -> NDArray[np.float32]:
        """(...) 1 where the board is white, 0 where dark, at (..., 2) places; white outside the print."""
        board, squares = self.board, places / self.board.square_length_m
        if board.has_circles:
            return self._beside_circles(squares)
        column, row = np.moveaxis(np.floor(squares).astype(np.int64), -1, 0)
        inside = (column >= 0) & (row >= 0) & (column < board.squares_x) & (row < board.squares_y)
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        white = np.where(inside, self._light[row, column], np.float32(1))
        if board.has_markers:
            cells = self._cells.shape[-1]
            local = (squares - np.stack([column, row], -1) - 0.5) * board.square_length_m / board.marker_length_m + 0.5
            cell = np.floor(local * cells).astype(np.int64)
            in_marker = inside & ((cell >= 0) & (cell < cells)).all(-1)
            cell = np.where(in_marker[..., None], cell, 0)
            white = np.where(in_marker, self._cells[row, column, cell[..., 1], cell[..., 0]], white)
        if board.kind == "aprilgrid":
            nearest = np.clip(np.rint(squares), 0, [board.squares_x, board.squares_y])
            half = (1 - board.marker_length_m / board.square_length_m) / 2
            white = np.where((np.abs(squares - nearest) < half).all(-1), np.float32(0), white)
        return np.asarray(white, np.float32)

    def _beside_circles(self, squares: Array) -> NDArray[np.float32]:
        """`whiteness` of a grid of circles, at (..., 2) places in squares."""
        board = self.board
        apart, radius = (2 if board.kind == "asymmetric_circles" else 1), board.marker_length_m / board.square_length_m / 2
        x, y = np.moveaxis(squares, -1, 0)
        white = np.ones(x.shape, np.float32)
        for step in (-1, 0, 1):  # large circles reach into the rows above and below
            row = np.clip(np.floor(y) + step, 0, board.squares_y - 1)
            first = 0.5 + (row % 2 if apart == 2 else 0.0)
            column = np.clip(np.rint((x - first) / apart), 0, board.squares_x - 1)
            white[np.hypot(x - first - apart * column, y - row - 0.5) < radius] = 0
        return white

    @property
    def _squares(self) -> list[tuple[int, int]]:
        """(column, row) of all squares, row by row."""
        return [(x, y) for y in range(self.board.squares_y) for x in range(self.board.squares_x)]

    def _is_dark(self, x: int, y: int) -> bool:
        board = self.board
        return (x + y + (board.squares_y % 2 == 0 and board.kind == "charuco" and board.legacy_pattern)) % 2 == 0

    @cached_property
    def _markers(self) -> dict[tuple[int, int], NDArray[np.bool_]]:
        """(cells, cells) of each marker by (column, row) of its square: true where it is dark, its border included."""
        board = self.board
        if not board.has_markers:
            return {}
        if board.has_tags:
            places = [(round(x - 0.5), round(y - 0.5)) for x, y in board.centres / board.square_length_m]
        else:
            places = [(x, y) for x, y in self._squares if not self._is_dark(x, y)]
        dictionary, first = dictionary_of(board), board.first_id if board.has_tags else 0
        cells, turned = dictionary.markerSize + 2 * board.border_bits, 2 if board.kind == "aprilgrid" else 0
        drawn = (dictionary.generateImageMarker(first + n, cells, borderBits=board.border_bits) < 128 for n in range(len(places)))
        return {place: np.rot90(dark, turned) for place, dark in zip(places, drawn, strict=True)}

    @cached_property
    def _light(self) -> NDArray[np.float32]:
        """(squares_y, squares_x) 1 where a square is white around its marker."""
        light = np.ones((self.board.squares_y, self.board.squares_x), np.float32)
        for x, y in self._squares:
            light[y, x] = not (self.board.is_checkered and self._is_dark(x, y))
        return light

    @cached_property
    def _cells(self) -> NDArray[np.float32]:
        """(squares_y, squares_x, cells, cells) 1 where the middle of a square is white."""
        cells = len(next(iter(self._markers.values())))
        found = np.repeat(np.repeat(self._light[..., None, None], cells, -1), cells, -2)
        for (x, y), dark in self._markers.items():
            found[y, x] = ~dark
        return found


def _runs(dark: NDArray[np.bool_], left: float, top: float, size: float) -> list[tuple[float, float, float, float]]:
    """Runs of dark cells in a row as one rectangle each: seams between cells could print as hairlines."""
    found = []
    for row, line in enumerate(dark):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]])))
        found += [(left + a * size, top + row * size, (b - a) * size, size) for a, b in edges.reshape(-1, 2)]
    return found
