"""A chessboard described as OpenCV counts it."""

import numpy as np
import pytest

from koala3d.calib.errors import TargetError
from koala3d.calib.sessions.session import observe
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.targets.board import Board

BOARD = Board.of("chessboard", 10, 7, 0.025)
CAMERA = Camera(320, 200, 285.0, 284.0, 161.0, 99.0)


@pytest.fixture(scope="module")
def views(tmp_path_factory, photograph):
    """Six pictures of a chessboard of 10x7 squares, one of them empty."""
    folder, found = tmp_path_factory.mktemp("chessboard"), []
    for number in range(6):
        turn = pose.from_rotation_vector([0.3 * np.cos(number), 0.3 * np.sin(number), 0.2 * number])
        turn[:3, 3] = [0, 0, 0.5] - turn[:3, :3] @ [0.125, 0.0875, 0]
        picture = photograph(BOARD, CAMERA, turn, rng=np.random.default_rng(number), samples=2)
        picture = np.full_like(picture, 0.5) if number == 3 else picture
        images.write(folder / f"{number}.png", np.rint(255 * np.repeat(picture[..., None], 3, -1)).astype(np.uint8))
        found.append((str(number), folder / f"{number}.png", np.eye(4)))
    return found


def test_inner_corners_given_as_squares_are_named(views):
    with pytest.raises(TargetError, match=r"show 10x7 squares, which have 9x6 inner corners.*say 10 and 7"):
        observe(Board.of("chessboard", 9, 6, 0.025), views)


def test_other_boards_are_not_suspected(views):
    with pytest.raises(TargetError, match=r"is not in any view.*squares, not inner corners"):
        observe(Board.of("chessboard", 14, 11, 0.025), views)
    assert len(observe(BOARD, views).observations) == 5
