"""The map from a board to its picture, and the middles of circles that depend on it."""

import cv2
import numpy as np
import pytest

from koala3d.calib.targets import circles, plane_map
from koala3d.calib.targets.detection import detect
from koala3d.datasets import conventions, pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.targets.board import Board
from koala3d.datasets.targets.pattern import Pattern

CAMERA = Camera(480, 300, 317.0, 317.0, 242.0, 132.0, -0.104, 0.053, 0.0007, 0.0009, -0.012)
GRID = Board.of("circles", 9, 7, 0.024, 0.014)


def placed(board, tilt, distance):
    """camera_from_board with the board's middle on the optical axis."""
    rotation = pose.from_rotation_vector(tilt)
    rotation[:3, 3] = [0, 0, distance] - rotation[:3, :3] @ board.points.mean(0)
    return rotation


def seen(camera_from_board, points):
    """(n, 2) pixels of (n, 2) places on the board."""
    flat = np.column_stack([points, np.zeros(len(points))])
    return CAMERA.project(flat @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])


def centroids(maps, board):
    """(n, 2) by how far the centroids of the circles lie beside the picture of their middles, under a map."""
    return np.array([circles._polygon_centroid(rim) for rim in circles._rims(board, maps, board.marker_length_m)]) - maps(
        board.points[:, :2]
    )


@pytest.mark.parametrize("tilt", [[0.0, 0.0, 0.0], [0.5, 0.2, 0.4], [-0.2, -0.6, 1.5]])
def test_shifts_of_circles_are_those_of_the_lens(tilt):
    camera_from_board, points = placed(GRID, tilt, 0.35), GRID.points[:, :2]
    found = plane_map.fit(points, seen(camera_from_board, points), CAMERA.width, CAMERA.height)
    true = centroids(lambda places: seen(camera_from_board, places), GRID)
    # shifts are up to 0.1 px; a polynomial beside a homography left 0.002 px, which spoils the focal length
    assert np.sqrt(((centroids(found, GRID) - true) ** 2).mean()) < 5e-4


def test_nine_points_are_enough():
    points = GRID.points[:, :2].reshape(7, 9, 2)[::3, ::4].reshape(-1, 2)
    camera_from_board = placed(GRID, [0.3, -0.2, 0.0], 0.4)
    found = plane_map.fit(points, seen(camera_from_board, points), CAMERA.width, CAMERA.height)
    assert len(points) == plane_map.FEWEST
    assert np.abs(found(points) - seen(camera_from_board, points)).max() < 0.02


def photograph(camera_from_board, light):
    """Picture of the grid under a lamp whose (h, w) light varies over the picture; 16 rays a pixel, encoded as sRGB."""
    total = np.zeros((CAMERA.height, CAMERA.width))
    board_from_camera, pattern = pose.inverse(camera_from_board), Pattern(GRID)
    places = np.arange(16)[:, None] * [0.7548776662, 0.5698402910] % 1 - 0.5  # Roberts' R2 sequence
    for place in places - places.mean(0):
        directions = CAMERA.directions(CAMERA.pixel_centres() + place) @ board_from_camera[:3, :3].T
        hit = board_from_camera[:3, 3] - directions * (board_from_camera[2, 3] / directions[..., 2])[..., None]
        total += 0.05 + 0.75 * pattern.whiteness(hit[..., :2])
    linear = cv2.GaussianBlur(total / 16, (0, 0), 0.5) * light
    return np.where(linear < 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055).astype(np.float32)


def test_uneven_light_does_not_draw_the_circles_to_it():
    camera_from_board = placed(GRID, [0.35, -0.3, 0.2], 0.36)
    columns = np.linspace(-1, 1, CAMERA.width)
    off = []
    for light in (np.ones(CAMERA.width), 1 - 0.35 * columns**2):
        found = detect(GRID, photograph(camera_from_board, light[None]), "view")
        assert found is not None and len(found.ids) == len(GRID.points)
        truth = seen(camera_from_board, GRID.points[:, :2])
        off.append(min((found.pixels - one for one in (truth, truth[::-1])), key=lambda e: np.abs(e).max()))
    assert np.sqrt((off[0] ** 2).mean()) < 0.01
    across = conventions.opencv_from_pixels(found.pixels)[:, 0] - CAMERA.width / 2
    slopes = [(across @ one[:, 0]) / (across @ across) for one in off]
    # darkness in absolute light drew them inwards by 1.1e-4 of their distance from the middle
    assert np.abs(slopes).max() < 3e-5
