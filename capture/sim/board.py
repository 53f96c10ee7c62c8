"""The calibration board as a camera sees it: exact, ray by ray, since a plane needs no renderer."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.sim import textures
from capture.sim.lens import Lens
from capture.sim.scenes import TABLE_SIZE
from capture.trajectory import CharucoTarget
from datasets import pose

INK, PAPER = 0.04, 0.95
"""Radiance of black and white [that of the lamps]."""
BORDER = 0.012
"""White paper around the squares [m]."""


@dataclass(frozen=True)
class BoardPicture:
    """A ChArUco board that lies on the table."""

    target: CharucoTarget
    base_from_board: NDArray[np.float64]
    seed: int
    centre: tuple[float, float]
    """Middle of the table [m]."""

    @cached_property
    def _table(self) -> NDArray[np.float32]:
        return textures.table_top(np.random.default_rng([self.seed, 11]))

    @cached_property
    def _markers(self) -> NDArray[np.float32]:
        """(squares_y, squares_x, cells, cells) the pattern inside each white square: 1 is white."""
        import cv2

        target = self.target
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
        cells = dictionary.markerSize + 2
        patterns = np.ones((target.squares_y, target.squares_x, cells, cells), np.float32)
        identity = 0
        for row in range(target.squares_y):
            for column in range(target.squares_x):
                if (row + column) % 2:
                    patterns[row, column] = dictionary.generateImageMarker(identity, cells, borderBits=1) / 255
                    identity += 1
        return patterns

    def whiteness(self, places: NDArray[np.float64]) -> NDArray[np.float32]:
        """(...,) 1 where the board is white, 0 where black, at (..., 2) board coordinates [m]; white beside the squares."""
        target = self.target
        squares = places / target.square_length_m
        column, row = np.moveaxis(np.floor(squares).astype(np.int64), -1, 0)
        inside = (column >= 0) & (row >= 0) & (column < target.squares_x) & (row < target.squares_y)
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        cells = self._markers.shape[-1]
        local = (squares - np.stack([column, row], -1) - 0.5) * target.square_length_m / target.marker_length_m + 0.5
        cell = np.floor(local * cells).astype(np.int64)
        in_marker = inside & ((cell >= 0) & (cell < cells)).all(-1)
        cell = np.where(in_marker[..., None], cell, 0)
        square = np.where(inside & ((column + row) % 2 == 0), 0.0, 1.0)
        return np.where(in_marker & (square > 0), self._markers[row, column, cell[..., 1], cell[..., 0]], square).astype(
            np.float32
        )

    def radiance(self, lens: Lens, base_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """(height, width, 3) linear light on each pixel of the lens's camera, averaged over its area."""
        total = np.zeros((lens.camera.height, lens.camera.width, 3))
        for place in lens.places():
            directions = np.concatenate([place, np.ones_like(place[..., :1])], -1) @ base_from_camera[:3, :3].T
            total += self._seen(base_from_camera[:3, 3], directions)
        return (total / lens.taps**2).astype(np.float32)

    def _seen(self, origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        target, board_from_base = self.target, pose.inverse(self.base_from_board)
        start, heading = board_from_base[:3, :3] @ origin + board_from_base[:3, 3], directions @ board_from_base[:3, :3].T
        places = (start - heading * (start[2] / np.where(heading[..., 2:] == 0, 1e-12, heading[..., 2:])))[..., :2]
        extent = np.array([target.squares_x, target.squares_y]) * target.square_length_m
        on_board = ((places > -BORDER) & (places < extent + BORDER)).all(-1) & (heading[..., 2] > 0)
        white = self.whiteness(places)[..., None]
        board = (INK + (PAPER - INK) * white) * np.array([1.0, 0.99, 0.97])
        down = directions[..., 2:]
        on_table = (origin - directions * (origin[2] / np.where(np.abs(down) < 1e-9, -1e-9, down)))[..., :2]
        cell = (on_table - self.centre) / TABLE_SIZE + 0.5
        resolution = self._table.shape[0]
        column, row = np.moveaxis(np.floor(np.clip(cell, 0, 1 - 1e-9) * resolution).astype(np.int64), -1, 0)
        seen = (down[..., 0] < 0) & ((cell > 0) & (cell < 1)).all(-1)
        table = np.where(seen[..., None], self._table[row, column], 0.1)
        lamp = 1.0 - 0.35 * np.clip(np.linalg.norm(on_table - self.centre, axis=-1), 0, 1)[..., None]
        return np.where(on_board[..., None], board, table) * lamp
