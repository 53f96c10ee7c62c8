"""Target sessions without pictures: true corners, with noise on the corners and on the arm's reports.

Rehearsals, benchmarks and tests use them. The arm's error is that of `calib.handeye.model`: the true flange is the reported
one moved by a small Gaussian motion, whose standard deviations per axis are given as `Accuracy`.
"""

from dataclasses import dataclass, replace

import numpy as np

from koala3d.calib.advice.information import inside_image
from koala3d.calib.advice.patterns import Rig
from koala3d.calib.arrays import Array
from koala3d.calib.handeye import model
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.targets.board import Board

Generator = np.random.Generator

SIGMA_PX = 0.1
ARM = Accuracy(3e-5, float(np.deg2rad(0.005)))  # per axis: what a UR5e repeats to
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
    session: Measurements
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


def simulate(
    rng: Generator,
    rig: Rig,
    base_from_camera: Array,
    *,
    sigma_px: float,
    arm: Accuracy,
    free: tuple[str, ...] = (),
    printed: Array | None = None,
) -> Simulated:
    """One session: corners inside the image with `sigma_px` of noise per axis, arm poses with errors of `arm`.

    `printed` (n, 3) is where the corners of a bad print truly are; the session believes that they are where they should be.
    """
    views = len(base_from_camera)
    errors = rng.normal(size=(views, 6)) * np.repeat([arm.translation_m, arm.rotation_rad], 3)
    missed = pose.from_rotation_vector(errors[:, 3:], errors[:, :3])
    reported = base_from_camera @ pose.inverse(rig.flange_from_camera) @ pose.inverse(missed)
    points = rig.board.points
    truth = State(projection.vector(rig.camera), rig.flange_from_camera, rig.base_from_board, errors)
    view, unseen = np.repeat(np.arange(views), len(points)), np.zeros((views * len(points), 2))
    every = Measurements(
        reported, view, unseen, np.tile(points, (views, 1)), free, accuracy=arm, form=projection.form(rig.camera)
    )
    truly = every if printed is None else replace(every, points=np.tile(printed, (views, 1)))
    pixels = projection.project(model.camera_points(truly, truth), truth.intrinsics, every.form)[0]
    session = replace(every, pixels=pixels + rng.normal(0, 1, pixels.shape) * sigma_px).some(inside_image(pixels, rig.camera))
    return Simulated(rig, base_from_camera, session, truth)


def target_session(simulated: Simulated, name: str = "simulated") -> TargetSession:
    """A simulated session in the form of a detected one."""
    camera = simulated.rig.camera
    seen, flown = tuple(simulated.observations()), simulated.session.base_from_flange
    return TargetSession(simulated.rig.board, camera.width, camera.height, seen, flown, provenance={"frames_sha256": name})
