"""A calibration target as a camera sees it, computed exactly for each ray: a plane needs no renderer."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.sim.laboratory import textures
from koala3d.capture.sim.laboratory.lens import Lens
from koala3d.capture.sim.laboratory.scenes import TABLE_SIZE
from koala3d.datasets import pose
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import Pattern

INK, PAPER = 0.04, 0.95  # radiance of black and white, relative to the lamps
DARK = 0.1  # radiance where nothing is
BORDER = 0.012  # white paper around the print [m]


@cache
def _table(seed: int) -> NDArray[np.float32]:
    return textures.table_top(np.random.default_rng([seed, 11]))


@dataclass(frozen=True)
class BoardPicture:
    """A calibration target on the table, or before a dark room."""

    target: Board
    table_from_board: NDArray[np.float64]
    seed: int
    centre: tuple[float, float] | None  # middle of the table [m]; None: there is no table, and even light

    @cached_property
    def _pattern(self) -> Pattern:
        return Pattern(self.target)

    def radiance(self, lens: Lens, table_from_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """(height, width, 3) linear light on each pixel of the lens camera, averaged over its area."""
        light = self._table_light(table_from_camera, _rays(lens.middles()))
        board = np.zeros(light.shape[:2])
        covered = np.zeros(light.shape[:2])
        for place in lens.places():
            on_board, white = self._board_light(table_from_camera, _rays(place))
            covered[on_board] += 1
            board[on_board] += INK + (PAPER - INK) * white
        share = (covered / lens.taps**2)[..., None]
        return (light[..., 3:] * (light[..., :3] * (1 - share) + (board / lens.taps**2)[..., None])).astype(np.float32)

    def _board_light(
        self, table_from_camera: NDArray[np.float64], rays: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Mask of the (h, w, 3) rays that hit the board, and the whiteness (n,) at these points."""
        board_from_camera = pose.inverse(self.table_from_board) @ table_from_camera
        start, heading = board_from_camera[:3, 3], rays @ board_from_camera[:3, :3].T
        facing = heading[..., 2] > 1e-9
        places = start[:2] - heading[..., :2] * (start[2] / np.where(facing, heading[..., 2], 1.0))[..., None]
        border = BORDER + self._pattern.overhang
        on_board = ((places > -border) & (places < self.target.size + border)).all(-1) & facing & (start[2] < 0)
        return on_board, self._pattern.whiteness(places[on_board])

    def _table_light(self, table_from_camera: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """(h, w, 4) colour of the table, and brightness of the lamps above it, where (h, w, 3) rays hit it."""
        if self.centre is None:
            return np.broadcast_to([DARK, DARK, DARK, 1.0], (*rays.shape[:2], 4))
        heading = rays @ table_from_camera[:3, :3].T
        down = np.minimum(heading[..., 2:], -1e-9)
        places = (table_from_camera[:3, 3] - heading * (table_from_camera[2, 3] / down))[..., :2] - self.centre
        cell = places / TABLE_SIZE + 0.5
        table = _table(self.seed)
        resolution = table.shape[0]
        column, row = np.moveaxis((np.clip(cell, 0, 1 - 1e-9) * resolution).astype(np.int64), -1, 0)
        seen = ((cell > 0) & (cell < 1)).all(-1) & (heading[..., 2] < 0)
        colour = np.where(seen[..., None], table[row, column], DARK)
        lamp = 1.0 - 0.35 * np.clip(np.linalg.norm(places, axis=-1, keepdims=True), 0, 1)
        return np.concatenate([colour, lamp], -1)


def _rays(places: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([places, np.ones_like(places[..., :1])], -1)
