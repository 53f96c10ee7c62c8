"""Target sessions without pictures: true corners, with noise on the corners and on the arm's reports.

Benchmarks and studies use them. The arm's error is that of `calib.handeye.model`: the true flange is the reported one moved
by a small Gaussian motion, whose standard deviations per axis are given as `Accuracy`.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Array, Mask
from calib.handeye import model
from calib.handeye.model import Accuracy, Session, State
from calib.intrinsics import projection
from calib.targets.detection import Observation
from datasets import pose
from datasets.board import Board
from datasets.camera_model import Camera

Generator = np.random.Generator


@dataclass(frozen=True)
class Rig:
    """What stands where, and what the camera is."""

    camera: Camera
    board: Board
    flange_from_camera: Array  # (4, 4)
    base_from_board: Array  # (4, 4)


@dataclass(frozen=True)
class Pattern:
    """How views lie around the board: each quantity is drawn evenly from its range."""

    tilt_deg: tuple[float, float] = (0.0, 35.0)  # between the optical axis and the board's normal; even over the sphere's surface
    distance_m: tuple[float, float] = (0.4, 0.6)  # from the camera to the point that it looks at
    roll_deg: tuple[float, float] = (-180.0, 180.0)  # about the optical axis
    shift_m: float = 0.03  # the point looked at lies up to this far beside the board's middle, along x and along y


KOALA = Rig(
    Camera(1920, 1080, 1700.0, 1698.0, 968.0, 534.0, -0.08, 0.05, 0.0006, -0.0004, 0.0),
    Board.of("charuco", 9, 7, 0.03, 0.022, "DICT_5X5_100"),
    pose.from_rotation_vector([np.deg2rad(45), 0, 0], [0.0, 0.06, 0.08]),
    pose.from_rotation_vector([np.pi, 0.0, 0.0], [0.265, 0.105, 0.003]),
)
"""The rig of configs/rigs/ur5e_basler.yaml with the board of configs/trajectories/calibration_demo.yaml."""


@dataclass(frozen=True)
class Simulated:
    """A session and the truth behind it."""

    rig: Rig
    base_from_camera: Array  # (views, 4, 4) where the camera truly was
    session: Session
    truth: State  # the truth, corrections included, so that noise-free corners are predicted exactly

    @property
    def camera_from_board(self) -> Array:
        """(views, 4, 4) true poses of the board."""
        return pose.inverse(self.base_from_camera) @ self.rig.base_from_board

    def observations(self) -> list[Observation]:
        """The corners by view, named "000", "001", ..."""
        ids = np.rint(self.session.points[:, :2] / self.rig.board.square_length_m).astype(np.int64)
        number = (ids[:, 1] - 1) * (self.rig.board.squares_x - 1) + ids[:, 0] - 1
        pixels, points = self.session.pixels, self.session.points
        masks = [self.session.view == i for i in range(len(self.base_from_camera))]
        return [Observation(f"{i:03d}", number[own], pixels[own], points[own]) for i, own in enumerate(masks)]


def viewpoints(rng: Generator, rig: Rig, views: int, pattern: Pattern) -> Array:
    """(views, 4, 4) base_from_camera on the board's seen side."""
    board = rig.base_from_board
    middle = np.append(rig.board.points[:, :2].mean(0), 0.0)
    low, high = np.deg2rad(pattern.tilt_deg)
    tilt = np.arccos(rng.uniform(np.cos(high), np.cos(low), views))
    side, roll = rng.uniform(0, 2 * np.pi, views), np.deg2rad(rng.uniform(*pattern.roll_deg, views))
    shift = np.column_stack([rng.uniform(-1, 1, (views, 2)) * pattern.shift_m, np.zeros(views)])
    tilts = pose.from_rotation_vector(tilt[:, None] * np.column_stack([np.cos(side), np.sin(side), 0 * side]))
    rolls = pose.from_rotation_vector(roll[:, None] * np.array([0.0, 0.0, 1.0]))
    board_from_camera = tilts @ rolls  # at no tilt the camera looks along the board's z axis, into it
    distance = rng.uniform(*pattern.distance_m, views)
    board_from_camera[:, :3, 3] = middle + shift - distance[:, None] * board_from_camera[:, :3, 2]
    return board @ board_from_camera


def inside_image(pixels: Array, camera: Camera) -> Mask:
    """(n,) which of (n, 2) pixels lie in the image, two pixels from its border."""
    return np.all((pixels > 2) & (pixels < [camera.width - 2, camera.height - 2]), axis=1)


def simulate(
    rng: Generator, rig: Rig, base_from_camera: Array, *, sigma_px: float, arm: Accuracy, free: tuple[str, ...] = ()
) -> Simulated:
    """One session: corners inside the image with `sigma_px` of noise per axis, arm poses with errors of `arm`."""
    views = len(base_from_camera)
    errors = rng.normal(size=(views, 6)) * np.repeat([arm.translation_m, arm.rotation_rad], 3)
    missed = pose.from_rotation_vector(errors[:, 3:], errors[:, :3])
    reported = base_from_camera @ pose.inverse(rig.flange_from_camera) @ pose.inverse(missed)
    points = rig.board.points
    truth = State(projection.vector(rig.camera), rig.flange_from_camera, rig.base_from_board, errors)
    view, unseen = np.repeat(np.arange(views), len(points)), np.zeros((views * len(points), 2))
    every = Session(reported, view, unseen, np.tile(points, (views, 1)), free, accuracy=arm)
    pixels = projection.project(model.camera_points(every, truth), truth.intrinsics)[0]
    session = replace(every, pixels=pixels + rng.normal(0, 1, pixels.shape) * sigma_px).some(inside_image(pixels, rig.camera))
    return Simulated(rig, base_from_camera, session, truth)
