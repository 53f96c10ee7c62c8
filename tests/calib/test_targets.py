import cv2
import numpy as np
import pytest

from calib.errors import TargetError
from calib.targets import Board
from datasets import pose
from datasets.camera_model import Camera

CHARUCO = Board("charuco", 9, 6, 0.03, 0.022, "DICT_5X5_100")
CHESSBOARD = Board("chessboard", 10, 7, 0.025)
CAMERA = Camera(960, 600, 850.0, 848.0, 484.0, 296.0, -0.08, 0.05, 0.0006, -0.0004, 0.0)


def board_picture(board, per_square):
    """(height, width) print of a board, 0..1, without a margin; drawn here, square by square."""
    rows, columns = np.arange(board.squares_y * per_square) // per_square, np.arange(board.squares_x * per_square) // per_square
    picture = ((rows[:, None] + columns) % 2).astype(np.float32)
    if board.type == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        side = round(per_square * board.marker_length_m / board.square_length_m)
        assert side == pytest.approx(per_square * board.marker_length_m / board.square_length_m), "the print must be exact"
        squares = [(row, column) for row in range(board.squares_y) for column in range(board.squares_x) if (row + column) % 2]
        for number, (row, column) in enumerate(squares):
            y, x = (per_square * place + (per_square - side) // 2 for place in (row, column))
            picture[y : y + side, x : x + side] = dictionary.generateImageMarker(number, side, borderBits=1) / 255
    return picture


def photograph(board, camera, camera_from_board, *, rng, noise=0.01, samples=4):
    """Picture of a board on grey ground: every pixel is the mean of samples^2 rays through the true lens."""
    per_square = 90
    print_ = board_picture(board, per_square)
    offsets = (np.arange(samples) + 0.5) / samples
    image = np.zeros((camera.height, camera.width))
    board_from_camera = pose.inverse(camera_from_board)
    corner = camera.pixel_centres() - 0.5
    for dx in offsets:
        for dy in offsets:
            directions = camera.directions(corner + np.array([dx, dy])) @ board_from_camera[:3, :3].T
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


def test_chessboard_keeps_its_first_corner_however_it_is_turned():
    for roll in np.arange(0, 2 * np.pi, np.pi / 4):
        camera_from_board = placed(CHESSBOARD, [0.2, 0.1, 0], roll, 0.5)
        grey = photograph(CHESSBOARD, CAMERA.scaled(480, 300), camera_from_board, rng=np.random.default_rng(2), samples=2)
        found = CHESSBOARD.detect(grey, "view")
        truth = CAMERA.scaled(480, 300).project(CHESSBOARD.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
        assert np.abs(found.pixels - truth).max() < 1  # upside down it would be hundreds


def test_an_empty_picture_shows_nothing():
    assert CHARUCO.detect(np.full((300, 480), 0.5, np.float32), "view") is None
    assert CHESSBOARD.detect(np.full((300, 480), 0.5, np.float32), "view") is None


def test_corners_on_one_line_are_not_enough():
    strip = Board("charuco", 12, 3, 0.03, 0.022)
    picture = np.ones((400, 1000), np.float32)
    print_ = board_picture(strip, 60)
    picture[40 : 40 + print_.shape[0], 20 : 20 + print_.shape[1]] = print_
    assert len(strip.detect(picture, "view").ids) == 22
    picture[40 + 100 :] = 1  # the lower row of corners is covered
    assert strip.detect(picture, "view") is None


def test_board_survives_its_description():
    for board in (CHARUCO, CHESSBOARD):
        assert Board.from_json({**board.to_json(), "maker": "unknown keys are passed over"}, where="manifest") == board


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"type": "charucco"}, "did you mean 'charuco'"),
        ({"dictionary": "DICT_5X5_10"}, "did you mean 'DICT_5X5_100'"),
        ({"squares_x": 2}, "2x6 squares"),
        ({"squares_x": "many"}, "not described completely"),
        ({"squares_x": None}, "squares_x"),
        ({"square_length_m": float("nan")}, "squares of nan m"),
        ({"marker_length_m": 0.04}, "markers of 0.04 m in squares of 0.03 m"),
        ({"type": "chessboard", "squares_x": 10}, "upside down"),
    ],
)
def test_impossible_boards_are_refused_in_one_line(change, message):
    with pytest.raises(TargetError, match=message) as error:
        Board.from_json({**CHARUCO.to_json(), **change}, where="manifest.json, board")
    assert "manifest.json, board" in str(error.value) and "\n" not in str(error.value)


def test_a_recording_without_target_says_so():
    with pytest.raises(TargetError, match="describes no calibration target"):
        Board.from_json(None, where="manifest.json, board")
