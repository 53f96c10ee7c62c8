import cv2
import numpy as np
import pytest

from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import Pattern

BOARDS = [
    Board.of("charuco", 7, 5, 0.03, 0.0225),
    Board.of("charuco", 6, 4, 0.03, 0.0225),
    Board.of("charuco", 6, 4, 0.03, 0.0225).model_copy(update={"legacy_pattern": True}),
    Board.of("chessboard", 5, 4, 0.03),
    Board.of("tags", 3, 2, 0.04, 0.03, "DICT_APRILTAG_36h11", first_id=5),
    Board.of("aprilgrid", 3, 2, 0.04, 0.03),
    Board.of("circles", 4, 3, 0.03, 0.02),
    Board.of("asymmetric_circles", 4, 5, 0.02, 0.022),  # larger than a row is high
]
IDS = ["charuco", "even rows", "legacy", "chessboard", "tags", "aprilgrid", "circles", "asymmetric circles"]
TAG_0 = 0xD5D628584
"""Number 0 of the family 36h11: bit 6 i + j is the cell of row i and column j, light where it is set."""


def places(board: Board, per_m: float, margin: float) -> np.ndarray:
    """(rows, columns, 2) middles of pixels of a board with a margin [m]."""
    x, y = (np.arange(-margin + 0.5 / per_m, edge + margin, 1 / per_m) for edge in board.size)
    return np.stack(np.meshgrid(x, y), -1)


@pytest.mark.parametrize("board", BOARDS[:3], ids=IDS[:3])
def test_charuco_boards_are_opencvs(board: Board) -> None:
    """Cells are whole pixels of OpenCV's drawing: a square of 56 px holds a marker of 42 px, 6 px a cell."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    drawn = cv2.aruco.CharucoBoard((board.squares_x, board.squares_y), 0.03, 0.0225, dictionary)
    drawn.setLegacyPattern(board.legacy_pattern)
    picture = drawn.generateImage((board.squares_x * 56, board.squares_y * 56), marginSize=0)
    white = Pattern(board).whiteness(places(board, 56 / 0.03, 0.0))
    assert np.mean(white != picture / 255) < 1e-3


@pytest.mark.parametrize("board", BOARDS, ids=IDS)
def test_what_is_printed_is_what_is_seen(board: Board) -> None:
    pattern, at = Pattern(board), places(board, 1937.0, 0.008)
    white = np.ones(at.shape[:2], bool)
    for x, y, width, height in pattern.rectangles:
        white &= ~((at > [x, y]) & (at < [x + width, y + height])).all(-1)
    for x, y, diameter in pattern.circles:
        white &= np.linalg.norm(at - [x, y], axis=-1) > diameter / 2
    assert 0.2 < white.mean() < 0.95
    assert np.mean(white != pattern.whiteness(at)) < 1e-4  # rounding at edges


def test_an_aprilgrid_is_kalibrs() -> None:
    """Tag 0 is the lower left one, with a border of two cells, drawn as Kalibr draws it; squares touch its corners."""
    board = Board.of("aprilgrid", 3, 2, 0.04, 0.03)
    cell = (np.arange(10) + 0.5) / 10 * 0.03
    tag = Pattern(board).whiteness(np.stack(np.meshgrid(0.005 + cell, 0.045 + cell), -1))
    code = np.array([[TAG_0 >> (6 * i + j) & 1 for j in range(6)] for i in range(6)])
    np.testing.assert_array_equal(tag[2:-2, 2:-2], np.rot90(code, 2))
    assert not tag[:2].any() and not tag[:, -2:].any()
    corners = board.points[:, :2]
    into = np.repeat(board.centres, 4, axis=0) - corners
    for way, expected in ((into, 0), (-into, 0), (into * [1, -1], 1), (into * [-1, 1], 1)):
        assert (Pattern(board).whiteness(corners + 0.1 * way) == expected).all()


def test_tags_of_an_aprilgrid_are_numbered_from_below_and_turned() -> None:
    points = Board.of("aprilgrid", 3, 2, 0.04, 0.03).points[:, :2]
    np.testing.assert_allclose(points[0], [0.035, 0.075])  # OpenCV's upper left corner is the lower right one on the print
    np.testing.assert_allclose(points[4] - points[0], [0.04, 0.0], atol=1e-12)
    np.testing.assert_allclose(points[12] - points[0], [0.0, -0.04], atol=1e-12)
