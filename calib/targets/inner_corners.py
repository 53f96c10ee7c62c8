"""Chessboards that are described by their inner corners, as OpenCV counts them, and not by their squares."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from koala3d.calib.errors import TargetError
from koala3d.calib.targets.detection import detect
from koala3d.datasets.targets.board import Board

NEARLY_NONE = 0.2  # a board that is found in a smaller share of the views may be another one
TRIED = 4  # pictures that are searched again


def explain(board: Board, pictures: Iterable[NDArray[np.float32]]) -> None:
    """Raise TargetError if pictures in which a chessboard was not found show one with one square more each way.

    Args:
        pictures: (height, width) brightness each, sRGB 0..1.
    """
    more = board.with_squares(board.squares_x + 1, board.squares_y + 1)
    found = [detect(more, picture, "") is not None for picture in pictures]
    if sum(found) * 2 > len(found):
        wrong, right = (f"{one.squares_x}x{one.squares_y}" for one in (board, more))
        why = f"the pictures show {right} squares, which have {wrong} inner corners"
        remedy = f"squares_x and squares_y count squares: say {more.squares_x} and {more.squares_y}"
        raise TargetError(f"chessboard of {wrong} squares is not in the pictures", why=why, remedy=remedy)
