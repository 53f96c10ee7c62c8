"""The true camera and mount of the simulated rig, which only the evaluation may know.

They differ from the nominal ones by random amounts, as in any real rig.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from koala3d.capture.model.carrier import Carrier
from koala3d.capture.model.trajectory import Trajectory
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError

SENSOR_WIDTH, SENSOR_HEIGHT = 1920, 1080
FOCAL_PX = 2.8e-3 / 2.2e-6  # a 2.8 mm lens over pixels of 2.2 um (Basler acA1920-25uc)
HAND_EYE_SHIFT_M = 3e-3  # length of the bracket's error
HAND_EYE_TURN_RAD = np.deg2rad(1.0)  # angle of the bracket's error


def seed_of_camera(seed: int, number: int) -> int:
    """Seed of lens, mount and noise of the camera of a rig with a number; the first one, 0, has the seed of the rig."""
    return seed if number == 0 else int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


@dataclass(frozen=True)
class BesideTruth:
    """The true places of a camera beside the arm and of the target on the flange."""

    base_from_camera: NDArray[np.float64]
    flange_from_board: NDArray[np.float64]


@dataclass(frozen=True)
class RigTruth:
    """The true camera of the whole sensor and the true mount."""

    sensor_camera: Camera
    flange_from_camera: NDArray[np.float64]  # without meaning where the camera stands beside the arm
    beside: BesideTruth | None = None  # None: the camera is on the flange

    def seen_from(self, base_from_flange: NDArray[np.float64]) -> NDArray[np.float64]:
        """(..., 4, 4) camera poses in the frame that carries what is seen: the base, or the flange with the target [m]."""
        if self.beside is None:
            return base_from_flange @ self.flange_from_camera
        return pose.inverse(base_from_flange) @ self.beside.base_from_camera

    @classmethod
    def of(cls, carrier: Carrier, trajectory: Trajectory, seed: int) -> Self:
        """The rig of a seed, whichever way the camera is mounted. Raises UsageError: only a target is seen from beside."""
        drawn, nominal = cls.draw(carrier.flange_from_camera, seed), carrier.beside
        if nominal is None:
            return drawn
        if trajectory.target is None:
            remedy = "use a trajectory with a target, such as calibration"
            raise UsageError("the camera stands beside the arm and sees only a target on the flange", remedy=remedy)
        rng = np.random.default_rng([seed, 8])
        camera, plate = (place @ _error(rng) for place in (nominal.base_from_camera, nominal.flange_from_plate))
        board = plate @ pose.rigid(np.eye(3), [*(-trajectory.target.size / 2), 0.0])
        return replace(drawn, beside=BesideTruth(camera, board))

    @classmethod
    def draw(cls, nominal_flange_from_camera: NDArray[np.float64], seed: int) -> Self:
        """The rig of a seed, independent of the scene."""
        rng = np.random.default_rng([seed, 7])
        fx = FOCAL_PX * (1 + rng.normal(0, 0.004))
        fy = fx * (1 + rng.normal(0, 2e-4))
        cx, cy = (edge / 2 + rng.normal(0, 10) for edge in (SENSOR_WIDTH, SENSOR_HEIGHT))
        k1, k2 = -0.11 + rng.normal(0, 0.01), 0.06 + rng.normal(0, 0.005)
        p1, p2 = rng.normal(0, 8e-4), rng.normal(0, 8e-4)
        camera = Camera(SENSOR_WIDTH, SENSOR_HEIGHT, fx, fy, cx, cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=-0.012)
        return cls(camera, nominal_flange_from_camera @ _error(rng))


def _error(rng: np.random.Generator) -> NDArray[np.float64]:
    """(4, 4) by how much a mount differs from its drawing."""
    return pose.from_rotation_vector(HAND_EYE_TURN_RAD * _direction(rng), HAND_EYE_SHIFT_M * _direction(rng))


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)
