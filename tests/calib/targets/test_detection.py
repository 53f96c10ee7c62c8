import cv2
import numpy as np
import pytest

from koala3d.calib.errors import TargetError
from koala3d.calib.targets.detection import detect, read_board
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.targets.board import Board

CHARUCO = Board.of("charuco", 9, 6, 0.03, 0.022, "DICT_5X5_100")
CHESSBOARD = Board.of("chessboard", 10, 7, 0.025)
CAMERA = Camera(480, 300, 425.0, 424.0, 242.0, 148.0, -0.08, 0.05, 0.0006, -0.0004, 0.0)


def placed(board, tilt, roll, distance):
    """camera_from_board with the board's middle on the optical axis."""
    rotation = pose.from_rotation_vector(tilt) @ pose.from_rotation_vector([0, 0, roll])
    rotation[:3, 3] = [0, 0, distance] - rotation[:3, :3] @ (
        np.array([board.squares_x, board.squares_y, 0]) * board.square_length_m / 2
    )
    return rotation


def test_corners_of_tags_are_where_they_were_put(photograph):
    for dictionary in ("DICT_APRILTAG_36h11", "DICT_5X5_100"):
        board = Board.of("tags", 4, 3, 0.05, 0.04, dictionary, first_id=7)
        for roll in (0.1, 2.0, 3.2):
            camera_from_board = placed(board, [0.35, -0.3, 0], roll, 0.42)
            found = detect(board, photograph(board, CAMERA, camera_from_board, rng=np.random.default_rng(1)), "view")
            assert found is not None and len(found.ids) == 48
            truth = CAMERA.project(found.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
            errors = found.pixels - truth
            assert np.sqrt((errors**2).sum(1).mean()) < 0.6 and np.abs(errors.mean(0)).max() < 0.1


def test_one_tag_is_a_target():
    single = Board.of("tags", 1, 1, 0.048, 0.048, "DICT_APRILTAG_36h11", first_id=10)
    assert single.points.shape == (4, 3) and np.abs(single.points).max() == 0.048
    picture = np.ones((300, 300), np.float32)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture[100:200, 100:200] = dictionary.generateImageMarker(10, 100) / 255
    found = detect(single, picture, "view")
    assert found.ids.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(found.pixels, [[100, 100], [200, 100], [200, 200], [100, 200]], atol=1)
    other = Board.of("tags", 1, 1, 0.048, 0.048, "DICT_APRILTAG_36h11", first_id=11)
    assert detect(other, picture, "view") is None


def test_chessboard_that_looks_the_same_upside_down_is_read_anyhow(photograph):
    even = Board.of("chessboard", 9, 7, 0.025)
    assert even.is_ambiguous and not CHESSBOARD.is_ambiguous
    camera_from_board = placed(even, [0.2, 0.1, 0], 0.3, 0.5)
    found = detect(even, photograph(even, CAMERA, camera_from_board, rng=np.random.default_rng(2), samples=2), "view")
    truth = CAMERA.project(even.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    assert min(np.abs(found.pixels - truth).max(), np.abs(found.pixels - truth[::-1]).max()) < 1


@pytest.mark.parametrize("roll", np.arange(0, 2 * np.pi, np.pi / 4))
def test_a_chessboard_as_wide_as_it_is_high_is_told_from_its_quarter_turns_by_colour(photograph, roll):
    square = Board.of("chessboard", 8, 8, 0.025)
    camera_from_board = placed(square, [0.2, 0.1, 0], roll, 0.5)
    found = detect(square, photograph(square, CAMERA, camera_from_board, rng=np.random.default_rng(2), samples=2), "view")
    truth = CAMERA.project(square.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    assert min(np.abs(found.pixels - truth).max(), np.abs(found.pixels - truth[::-1]).max()) < 1


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=["charuco", "chessboard"])
@pytest.mark.parametrize("roll", [0.1, 2.0, 3.2])
def test_corners_of_a_photograph_are_where_they_were_put(photograph, board, roll):
    camera_from_board = placed(board, [0.35, -0.3, 0], roll, 0.42)
    grey = photograph(board, CAMERA, camera_from_board, rng=np.random.default_rng(1))
    found = detect(board, grey, "view")
    assert found is not None and len(found.ids) > 0.8 * len(board.points)
    truth = CAMERA.project(found.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    errors = found.pixels - truth
    # at 1 % noise about 0.02 px on pictures made of 144 rays a pixel; 16 rays leave a little more
    assert np.sqrt((errors**2).sum(1).mean()) < 0.05
    assert np.abs(errors.mean(0)).max() < 0.02  # a convention mixed up would be half a pixel
    np.testing.assert_array_equal(found.points, board.points[found.ids])


def test_chessboard_keeps_its_first_corner_however_it_is_turned(photograph):
    for roll in np.arange(0, 2 * np.pi, np.pi / 4):
        camera_from_board = placed(CHESSBOARD, [0.2, 0.1, 0], roll, 0.5)
        grey = photograph(CHESSBOARD, CAMERA, camera_from_board, rng=np.random.default_rng(2), samples=2)
        found = detect(CHESSBOARD, grey, "view")
        truth = CAMERA.project(CHESSBOARD.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
        assert np.abs(found.pixels - truth).max() < 1  # upside down it would be hundreds


@pytest.mark.parametrize("size", [4000, 2000])
def test_a_chessboard_in_a_large_picture_is_found_in_a_smaller_one(photograph, size):
    """The corners are those of the large picture: near the middle, or small in its corner so that the first look misses it."""
    camera_from_board = placed(CHESSBOARD, [0.2, 0.1, 0], 0.3, 0.5)
    grey = photograph(CHESSBOARD, CAMERA, camera_from_board, rng=np.random.default_rng(2), samples=2)
    truth = CAMERA.project(CHESSBOARD.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
    if size == 4000:
        ratio = np.array([4000 / 480, 2500 / 300])
        large = cv2.resize(grey.astype(np.float32), (4000, 2500), interpolation=cv2.INTER_CUBIC)
    else:
        ratio, large = 1.0, np.full((1400, 2000), grey.mean(), np.float32)
        large[:300, :480] = grey
    found = detect(CHESSBOARD, large, "view")
    assert found is not None and np.abs(found.pixels - truth * ratio).max() < 1.5 * np.max(ratio)


def test_an_empty_picture_shows_nothing():
    assert detect(CHARUCO, np.full((300, 480), 0.5, np.float32), "view") is None
    assert detect(CHESSBOARD, np.full((300, 480), 0.5, np.float32), "view") is None


def test_corners_on_one_line_are_not_enough(board_picture):
    strip = Board.of("charuco", 12, 3, 0.03, 0.022)
    picture = np.ones((400, 1000), np.float32)
    print_ = board_picture(strip, 60)
    picture[40 : 40 + print_.shape[0], 20 : 20 + print_.shape[1]] = print_
    assert len(detect(strip, picture, "view").ids) == 22
    picture[40 + 100 :] = 1  # the lower row of corners is covered
    assert detect(strip, picture, "view") is None


def test_a_board_is_read_from_a_manifest():
    for board in (CHARUCO, CHESSBOARD):
        assert read_board({**board.to_json(), "maker": "unknown keys are ignored"}, where="manifest") == board


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"type": "charucco"}, "'charuco', 'chessboard', 'tags', 'aprilgrid', 'circles' or 'asymmetric_circles'"),
        ({"dictionary": "DICT_5X5_10"}, "did you mean 'DICT_5X5_100'"),
        ({"squares_x": 2}, "2x6 squares"),
        ({"squares_x": None}, "squares_x"),
        ({"marker_length_m": 0.04}, "marker_length_m 0.04"),
        ({"dictionary": "DICT_4X4_50", "squares_x": 15, "squares_y": 10}, "75 markers are needed, DICT_4X4_50 has 50"),
        ({"type": "tags", "first_id": 99}, "markers are needed, DICT_5X5_100 has 100"),
    ],
)
def test_impossible_boards_are_refused_in_one_line(change, message):
    with pytest.raises(TargetError, match=message) as error:
        read_board({**CHARUCO.to_json(), **change}, where="manifest.json, board")
    assert "manifest.json, board" in str(error.value) and "\n" not in str(error.value)


def test_a_recording_without_target_says_so():
    with pytest.raises(TargetError, match="describes no calibration target"):
        read_board(None, where="manifest.json, board")
