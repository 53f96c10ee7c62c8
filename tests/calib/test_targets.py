import numpy as np
import pytest

from calib.targets import Board
from datasets import pose
from datasets.camera_model import Camera

CHARUCO = Board("charuco", 9, 6, 0.03, 0.022, "DICT_5X5_100")
CHESSBOARD = Board("chessboard", 10, 7, 0.025)
CAMERA = Camera(960, 600, 850.0, 848.0, 484.0, 296.0, -0.08, 0.05, 0.0006, -0.0004, 0.0)


def board_picture(board, pixels_per_square):
    """(height, width) print of a board, 0..1, without a margin."""
    width, height = board.squares_x * pixels_per_square, board.squares_y * pixels_per_square
    if board.type == "charuco":
        return board.charuco.generateImage((width, height), marginSize=0, borderBits=1) / 255.0
    rows, columns = np.arange(height) // pixels_per_square, np.arange(width) // pixels_per_square
    return ((rows[:, None] + columns) % 2).astype(float)


def photograph(board, camera, camera_from_board, *, rng, noise=0.01, samples=4):
    """Picture of a board on grey ground: every pixel is the mean of samples^2 rays through the true lens."""
    per_square = 80
    print_ = board_picture(board, per_square)
    offsets = (np.arange(samples) + 0.5) / samples
    image = np.zeros((camera.height, camera.width))
    board_from_camera = pose.inverse(camera_from_board)
    corner = camera.pixel_centres() - 0.5
    for dx in offsets:
        for dy in offsets:
            directions = camera.directions(corner + [dx, dy]) @ board_from_camera[:3, :3].T
            reach = -board_from_camera[2, 3] / directions[..., 2]
            hit = board_from_camera[:3, 3] + reach[..., None] * directions
            at = np.floor(hit[..., :2] / board.square_length_m * per_square).astype(int)
            on = ((at >= 0) & (at < [print_.shape[1], print_.shape[0]])).all(-1)
            at = np.where(on[..., None], at, 0)
            image += np.where(on, 0.1 + 0.75 * print_[at[..., 1], at[..., 0]], 0.85)
    image = image / samples**2 + rng.normal(0, noise, image.shape)
    return np.clip(image, 0, 1).astype(np.float32)


def placed(board, tilt, roll, distance):
    """camera_from_board with the board's middle on the optical axis."""
    rotation = pose.from_rotation_vector(tilt) @ pose.from_rotation_vector([0, 0, roll])
    rotation[:3, 3] = [0, 0, distance] - rotation[:3, :3] @ (
        np.array([board.squares_x, board.squares_y, 0]) * board.square_length_m / 2
    )
    return rotation


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=["charuco", "chessboard"])
@pytest.mark.parametrize("roll", [0.1, 2.0, 3.2])
def test_corners_of_a_photograph_are_where_they_were_put(board, roll):
    camera_from_board = placed(board, [0.35, -0.3, 0], roll, 0.42)
    grey = photograph(board, CAMERA, camera_from_board, rng=np.random.default_rng(1))
    found = board.detect(grey, "view")
    assert found is not None and len(found.ids) > 0.8 * len(board.points)
    truth = CAMERA.project(found.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    errors = found.pixels - truth
    # a corner between squares of 60 px at 1 % noise: a few hundredths of a pixel, and no shift of half a pixel
    assert np.sqrt((errors**2).sum(1).mean()) < 0.12
    assert np.abs(errors.mean(0)).max() < 0.03
    np.testing.assert_array_equal(found.points, board.points[found.ids])
