"""A target as meshes: a light plate, and what is printed on it a tenth of a millimetre in front."""

import numpy as np
from numpy.typing import NDArray

from koala3d.calib.arrays import Array
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import Pattern

DISC_CORNERS = 24
LIGHT, DARK = 235, 30  # grey of the plate and of the print
Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""Vertices and faces."""


def parts(board: Board) -> dict[str, tuple[Mesh, int]]:
    """Mesh [m] in the frame of the board, and grey, of each part by name."""
    pattern = Pattern(board)
    found = {"plate": (_rectangles(np.array([[0, 0, *board.size]]), 0.0), LIGHT)}
    if len(pattern.rectangles):
        found["squares"] = _rectangles(pattern.rectangles, -1e-4), DARK
    if len(pattern.circles):
        found["circles"] = _discs(pattern.circles, -1e-4), DARK
    return found


def _rectangles(places: Array, height: float) -> Mesh:
    """Rectangles (n, 4), x, y, width and height each, in the plane z = `height`."""
    steps = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return _fans(places[:, None, :2] + steps * places[:, None, 2:], height)


def _discs(places: Array, height: float) -> Mesh:
    """Discs (n, 3), middle and diameter each, in the plane z = `height`."""
    turn = 2 * np.pi * np.arange(DISC_CORNERS) / DISC_CORNERS
    return _fans(places[:, None, :2] + np.stack([np.cos(turn), np.sin(turn)], -1) * places[:, None, 2:] / 2, height)


def _fans(corners: Array, height: float) -> Mesh:
    """Convex polygons with (n, m, 2) corners, as triangles from each one's first corner."""
    count = corners.shape[1]
    flat = corners.reshape(-1, 2)
    vertices = np.concatenate([flat, np.full((len(flat), 1), height)], axis=1)
    first = count * np.arange(len(corners))[:, None]
    faces = np.concatenate([first + np.array([0, k, k + 1]) for k in range(1, count - 1)])
    return vertices.astype(np.float32), faces.astype(np.uint32)
