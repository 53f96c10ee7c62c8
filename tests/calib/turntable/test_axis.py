import numpy as np
import pytest

from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.calib.turntable.axis import find
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.residuals import Residuals
from koala3d.datasets.turntable import Axis

SIGMA_PX = 0.05
MOUNT = pose.from_rotation_vector([0.8, 0.02, -0.01], [0.002, 0.06, 0.08])
MOUNT_STD = np.repeat([1e-4, 2e-4], 3)  # [m, rad]
TRUE = Axis.of(pose.from_rotation_vector([0.004, -0.007, 0.0], [0.402, -0.003, 0.0]))
BOARD = pose.from_rotation_vector([np.pi, 0, 0], [0.265, 0.105, 0.003])


def session_of(rng: np.random.Generator, angles: np.ndarray, scale: float = 1.0, noise: bool = True):
    """A session as the simulated rig would record it from three places, and the calibration with an error of its own mount."""
    board = KOALA.board
    corners = np.array([[x, y, 0] for y in range(1, board.squares_y) for x in range(1, board.squares_x)]) * board.square_length_m
    observations, flanges = [], []
    for place, azimuth in enumerate(np.radians([30, 90, 150])):
        eye = [0.4 + 0.2 * np.cos(azimuth), 0.2 * np.sin(azimuth), 0.33]
        flange = pose.look_at(eye, [0.4, 0.0, 0.0]) @ pose.inverse(MOUNT)
        slack = pose.from_rotation_vector(rng.normal(0, 2e-5, 3), rng.normal(0, 3e-5, 3)) if noise else np.eye(4)
        for index, angle in enumerate(angles):
            moved = pose.inverse(flange @ slack @ MOUNT) @ TRUE.base_from_object(scale * angle) @ BOARD
            inside = corners @ moved[:3, :3].T + moved[:3, 3]
            pixels = projection.project(inside, projection.vector(KOALA.camera))[0]
            pixels = pixels + rng.normal(0, SIGMA_PX * noise, pixels.shape)
            observations.append(Observation(f"{place}{index:02d}", np.arange(len(corners)), pixels, corners))
            flanges.append(flange)
    error = rng.normal(0, MOUNT_STD) if noise else np.zeros(6)
    mount = UncertainPose(pose.from_rotation_vector(error[3:], error[:3]) @ MOUNT, np.diag(MOUNT_STD**2))
    camera = KOALA.camera
    facts = Residuals(arm_translation_mm=0.03, arm_rotation_deg=float(np.degrees(2e-5)))
    session = TargetSession(board, camera.width, camera.height, tuple(observations), np.stack(flanges))
    return session, np.tile(angles, 3), Calibration(camera, {}, flange_from_camera=mount, residuals=facts)


def errors(found: Axis) -> np.ndarray:
    """(4,) shifts across the true axis [m], at the point that was found, and tilts [rad]."""
    first, second = np.array([[1.0, 0, 0], [0, 1.0, 0]])
    away = found.point - TRUE.point
    away = away - (away @ TRUE.direction) * TRUE.direction
    off = found.direction - TRUE.direction
    return np.array([away @ first, away @ second, off @ first, off @ second])


def test_without_noise_the_true_axis_is_found():
    found = find(*session_of(np.random.default_rng(0), np.radians(np.arange(0, 360, 90)), noise=False))
    assert np.abs(errors(found.axis)).max() < 1e-7 and found.rms_px < 1e-5
    np.testing.assert_allclose(found.base_from_board, BOARD, atol=1e-7)
    assert found.scale == pytest.approx(1.0, abs=1e-8)


def test_the_stated_covariance_is_that_of_the_errors():
    """Squared errors over their covariance follow chi-square: of four degrees of freedom, over so many sessions."""
    squares, rng = [], np.random.default_rng(1)
    for _ in range(10):
        found = find(*session_of(rng, np.radians(np.arange(0, 360, 60))))
        rows = [0, 1, 3, 4]  # x and y of point and direction: across an axis that is nearly upright
        covariance = found.axis.covariance[np.ix_(rows, rows)]
        off = errors(found.axis)
        squares.append(float(off @ np.linalg.solve(covariance, off)))
    assert 1.8 < np.mean(squares) < 6.2  # 4 within 2.5 standard errors, sqrt(8 / 10) each


def test_a_gear_that_is_not_what_the_rig_file_says_is_measured():
    found = find(*session_of(np.random.default_rng(2), np.radians(np.arange(0, 330, 65)), scale=1.003))
    assert found.scale == pytest.approx(1.003, abs=5 * found.scale_std) and found.scale_std < 1e-4


def test_a_board_that_turns_the_other_way_is_an_error():
    session, angles, calibration = session_of(np.random.default_rng(3), np.radians(np.arange(0, 360, 90)), scale=-1.0)
    found = find(session, angles, calibration)
    assert found.axis.direction[2] < -0.99  # it is the axis that points down
    session, angles, calibration = session_of(np.random.default_rng(3), np.radians(np.arange(0, 120, 15)), scale=1.5)
    with pytest.raises(CalibrationError, match=r"did not turn as the table reported.*1.50 of the reported angles"):
        find(session, angles, calibration)


def test_too_little_motion_is_refused():
    session, angles, calibration = session_of(np.random.default_rng(4), np.radians([0.0, 5.0, 10.0]))
    with pytest.raises(Unobservable, match="9 views of the board over 10 degrees"):
        find(session, angles, calibration)
