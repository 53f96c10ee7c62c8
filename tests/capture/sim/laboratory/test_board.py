import cv2
import numpy as np
import pytest

from koala3d.capture.sim.laboratory.board import BoardPicture
from koala3d.capture.sim.laboratory.lens import Lens, Sensor
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import pixels_from_opencv
from koala3d.datasets.targets.board import Board

TARGET = Board.of("charuco", 7, 5, 0.03, 0.0225)
TABLE_FROM_BOARD = pose.from_rotation_vector([np.pi, 0, 0], [0.35, 0.08, 0.003])
CAMERA = Camera(640, 480, 560.0, 561.0, 331.0, 228.0, k1=-0.11, k2=0.06, p1=8e-4, p2=-9e-4)


@pytest.fixture(scope="module")
def picture() -> BoardPicture:
    return BoardPicture(TARGET, TABLE_FROM_BOARD, seed=0, centre=(0.45, 0.0))


def opencv_board() -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    return cv2.aruco.CharucoBoard((7, 5), 0.03, 0.0225, dictionary)


@pytest.mark.parametrize(("position", "roll"), [((0.45, 0.0, 0.35), 0.3), ((0.30, -0.15, 0.30), -1.0), ((0.6, 0.1, 0.32), 2.5)])
def test_detected_corners_lie_where_the_camera_model_says(picture, position, roll):
    table_from_camera = pose.look_at(position, (0.45, 0.0, 0.0)) @ pose.from_rotation_vector([0, 0, roll])
    light = picture.radiance(Lens(CAMERA), table_from_camera)
    pixels = Sensor().expose(light, exposure_us=10000, gain_db=0, binning=2, rng=np.random.default_rng(0))
    board = opencv_board()
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
    assert ids is not None and len(ids) >= 20  # of 24
    camera_from_board = pose.inverse(table_from_camera) @ TABLE_FROM_BOARD
    on_board = np.asarray(board.getChessboardCorners(), np.float64)[np.asarray(ids).ravel().tolist()]
    points = on_board @ camera_from_board[:3, :3].T + camera_from_board[:3, 3]
    errors = pixels_from_opencv(corners.reshape(-1, 2)) - CAMERA.project(points)
    assert np.sqrt((errors**2).mean()) < 0.1  # px: what the detector reaches on clean pictures
    assert np.abs(errors.mean(0)).max() < 0.03  # half a pixel of convention would show here


def test_back_of_the_board_is_not_seen(picture):
    from_below = pose.look_at((0.45, 0.0, -0.3), (0.45, 0.0, 0.0))
    assert picture.radiance(Lens(CAMERA), from_below).max() < 0.5
