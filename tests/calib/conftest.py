"""Simulated target sessions without pictures: true corners, noise on corners and on the arm's reports."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib import model, projection
from calib.targets import Board, Observation
from datasets import pose
from datasets.camera_model import Camera

BOARD = Board("charuco", 11, 8, 0.03, 0.022, "DICT_5X5_100")
CAMERA = Camera(960, 600, 850.0, 848.0, 484.0, 296.0, -0.08, 0.05, 0.0006, -0.0004, 0.0)
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

    def session(self, **options) -> model.Session:
        view = np.repeat(np.arange(len(self.observations)), [len(o.ids) for o in self.observations])
        return model.Session(
            self.reported, view, np.concatenate([o.pixels for o in self.observations]),
            np.concatenate([o.points for o in self.observations]), **options,
        )  # fmt: skip

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
    return Simulated(BOARD, observations, np.stack(reported), camera, FLANGE_FROM_CAMERA, BASE_FROM_BOARD)


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
def with_camera():
    """Function that changes fields of a simulated session."""
    return replace
