"""Simulated target sessions without pictures: true corners, noise on corners and on the arm's reports."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import pytest

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.handeye import model
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import observe_recording
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.imaging import images
from koala3d.datasets.recording import Frame, Recording
from koala3d.datasets.targets.board import Board

BOARD = Board.of("charuco", 11, 8, 0.03, 0.022, "DICT_5X5_100")
CAMERA = Camera(960, 600, 850.0, 848.0, 484.0, 296.0, -0.08, 0.05, 0.0006, -0.0004, 0.0)
SMALL_CAMERA = CAMERA.scaled(480, 300)
FLANGE_FROM_CAMERA = pose.from_rotation_vector([0.05, -0.03, 1.55], [0.06, 0.01, 0.08])
BASE_FROM_BOARD = pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.35, 0.10, 0.0])  # lies on the table, z into it


@dataclass(frozen=True)
class Simulated:
    """One session: what was observed, what the arm said, and the truth."""

    board: Board
    observations: list[Observation]
    reported: np.ndarray
    camera: Camera = CAMERA
    flange_from_camera: np.ndarray = None
    base_from_board: np.ndarray = None
    taken: np.ndarray = None  # (views, 4, 4) true base_from_camera

    def session(self, **options) -> model.Measurements:
        view = np.repeat(np.arange(len(self.observations)), [len(o.ids) for o in self.observations])
        return model.Measurements(
            self.reported,
            view,
            np.concatenate([o.pixels for o in self.observations]),
            np.concatenate([o.points for o in self.observations]),
            **options,
        )

    def state(self) -> model.State:
        """The truth as a start."""
        corrections = np.zeros((len(self.reported), 6))
        return model.State(projection.vector(self.camera), self.flange_from_camera, self.base_from_board, corrections)


def viewpoints(rng, views, tilt_deg=35.0, axis=None, turn=True):
    """(views, 4, 4) base_from_camera above the board; `axis` keeps to tilts about one axis, `turn` rolls the camera."""
    poses = []
    centre = BASE_FROM_BOARD @ [*BOARD.points.mean(0)[:2], 0, 1]
    for _ in range(views):
        direction = rng.uniform(0, 2 * np.pi) if axis is None else axis
        angle = np.deg2rad(tilt_deg) * (np.sqrt(rng.uniform(0.05, 1)) if axis is None else rng.uniform(-1, 1))
        roll = rng.uniform(-0.6, 0.6) if turn else 0.0
        tilt = pose.from_rotation_vector(angle * np.array([np.cos(direction), np.sin(direction), 0]))
        down = tilt @ pose.from_rotation_vector([np.pi, 0, 0]) @ pose.from_rotation_vector([0, 0, roll])
        down[:3, 3] = centre[:3] - down[:3, 2] * rng.uniform(0.35, 0.55) + rng.uniform(-0.03, 0.03, 3)
        poses.append(down)
    return np.stack(poses)


def _simulate(seed=0, views=20, noise_px=0.1, translation_m=5e-5, rotation_deg=0.01, poses=None, camera=CAMERA, outliers=0):
    rng = np.random.default_rng(seed)
    base_from_camera = viewpoints(rng, views) if poses is None else poses(rng)
    observations, reported = [], []
    for index, view in enumerate(base_from_camera):
        in_camera = (
            BOARD.points @ (pose.inverse(view) @ BASE_FROM_BOARD)[:3, :3].T + (pose.inverse(view) @ BASE_FROM_BOARD)[:3, 3]
        )
        pixels = camera.project(in_camera)
        ids = np.flatnonzero(((pixels > 2) & (pixels < [camera.width - 2, camera.height - 2])).all(1))
        assert len(ids) >= 20, "a simulated view must see the board"
        seen = pixels[ids] + rng.normal(0, noise_px, (len(ids), 2))
        wrong = rng.choice(len(ids), outliers, replace=False)
        seen[wrong] += rng.uniform(5, 20, (outliers, 2))
        observations.append(Observation(f"{index:03d}", ids, seen, BOARD.points[ids]))
        error = np.concatenate([rng.normal(0, translation_m, 3), rng.normal(0, np.deg2rad(rotation_deg), 3)])
        true = view @ pose.inverse(FLANGE_FROM_CAMERA)
        reported.append(true @ pose.inverse(model.perturbed(np.eye(4), error)))
    return Simulated(BOARD, observations, np.stack(reported), camera, FLANGE_FROM_CAMERA, BASE_FROM_BOARD, base_from_camera)


@lru_cache
def _rays(camera, samples):
    """samples^2 sets (3, height * width) of ray directions, spread over each pixel, but not along lines as edges are."""
    places = np.arange(samples**2)[:, None] * [0.7548776662, 0.5698402910] % 1 - 0.5  # Roberts' R2 sequence
    centres = camera.pixel_centres().reshape(-1, 2)
    return [camera.directions(centres + place - places.mean(0)).T.astype(np.float32) for place in places]


def _board_picture(board, per_square):
    """(height, width) print of a board, 0..1, without a margin; drawn here, square by square."""
    rows, columns = np.arange(board.squares_y * per_square) // per_square, np.arange(board.squares_x * per_square) // per_square
    picture = ((rows[:, None] + columns) % 2).astype(np.float32)
    if board.kind == "tags":
        picture[:] = 1.0
    if board.kind != "chessboard":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        side = round(per_square * board.marker_length_m / board.square_length_m)
        assert side == pytest.approx(per_square * board.marker_length_m / board.square_length_m), "the print must be exact"
        squares = [(row, column) for row in range(board.squares_y) for column in range(board.squares_x)]
        squares = squares if board.kind == "tags" else [(row, column) for row, column in squares if (row + column) % 2]
        for number, (row, column) in enumerate(squares, board.first_id):
            y, x = (per_square * place + (per_square - side) // 2 for place in (row, column))
            picture[y : y + side, x : x + side] = dictionary.generateImageMarker(number, side, borderBits=1) / 255
    return picture


def _photograph(board, camera, camera_from_board, *, rng, noise=0.01, samples=4):
    """Picture of a board on grey ground: every pixel is the mean of samples^2 rays through the true lens."""
    per_square = 90
    print_ = 0.1 + 0.75 * _board_picture(board, per_square)
    board_from_camera = pose.inverse(camera_from_board)
    turn, place = board_from_camera[:3, :3], board_from_camera[:3, 3]
    on_board = np.stack([*(place[:2, None] * turn[2] - place[2] * turn[:2]), turn[2]])  # ray to homogeneous place
    on_print = (np.diag([*2 * [per_square / board.square_length_m], 1]) @ on_board).astype(np.float32)  # 1e-3 of its squares
    image = np.zeros((camera.height, camera.width), np.float32)
    for rays in _rays(camera, samples):
        x, y, scale = on_print @ rays
        columns, rows = ((axis / scale - 0.5).reshape(image.shape) for axis in (x, y))  # OpenCV counts from a pixel's centre
        image += cv2.remap(print_, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0.85)
    image = cv2.GaussianBlur(image / samples**2, (0, 0), 0.5) + rng.normal(0, noise, image.shape)  # no lens is sharper
    return np.clip(image, 0, 1).astype(np.float32)


@pytest.fixture(scope="session")
def simulate():
    """Function that simulates a target session."""
    return _simulate


@pytest.fixture(scope="session")
def make_viewpoints():
    """Function that places cameras above the board."""
    return viewpoints


@pytest.fixture(scope="session")
def small(simulate):
    """One ordinary session of 12 views."""
    return simulate(seed=3, views=12)


@pytest.fixture(scope="session")
def photograph():
    """Function that takes a picture of a board through the true lens."""
    return _photograph


@pytest.fixture(scope="session")
def board_picture():
    """Function that draws a board."""
    return _board_picture


@pytest.fixture(scope="session")
def make_recording():
    """Function that writes a recording of a target session, pictures and all, and returns its truth."""

    def make(path, *, seed=0, views=12, blank=(), camera=SMALL_CAMERA, beside=None):
        """`beside` is another board in the pictures, with its pose in the base."""
        session = _simulate(seed=seed, views=views, camera=camera)
        recording = Recording.create(path, {"trajectory": {}, "board": {**BOARD.to_json(), "name": "extra keys do no harm"}})
        rng = np.random.default_rng(seed)
        for index, reported in enumerate(session.reported):
            name = f"{index:03d}"
            camera_from_board = pose.inverse(session.taken[index]) @ BASE_FROM_BOARD
            grey = (
                np.full((camera.height, camera.width), 0.5)
                if index in blank
                else _photograph(BOARD, camera, camera_from_board, rng=rng)
            )
            if beside is not None:  # the ground is as light as the boards' margins, so the darker one is in front
                other, base_from_other = beside
                where = pose.inverse(session.taken[index]) @ base_from_other
                grey = np.minimum(grey, _photograph(other, camera, where, rng=rng))
            image = path / "images" / f"{name}.png"
            images.write(image, np.rint(255 * np.repeat(grey[..., None], 3, -1)).astype(np.uint8))
            recording.append(
                Frame(
                    index=index,
                    name=name,
                    split="calibration",
                    image=f"images/{name}.png",
                    base_from_flange=reported,
                    joints=np.zeros(6),
                    robot_time_s=0.0,
                    host_time_ns=0,
                    device_ticks=0,
                    exposure_us=1e4,
                    settle_s=0.1,
                    sha256="0" * 64,
                )
            )
        return session

    return make


@pytest.fixture(scope="session")
def recorded(tmp_path_factory, make_recording):
    """(path, truth) of a recorded target session of 12 views, the last of which shows no target."""
    path = tmp_path_factory.mktemp("calib") / "recording"
    return path, make_recording(path, blank=(11,))


@pytest.fixture(scope="session")
def observed(recorded):
    """What was seen in the pictures of `recorded`."""
    return observe_recording(recorded[0])


@pytest.fixture(scope="session")
def calibrated(observed):
    """The calibration that `recorded` gives."""
    return calibrate_handeye(observed)


@pytest.fixture(scope="session")
def recorded_again(tmp_path_factory, make_recording):
    """(path, truth) of a recording of 8 views with the same camera of the same target."""
    path = tmp_path_factory.mktemp("calib") / "again"
    return path, make_recording(path, seed=1, views=8)
