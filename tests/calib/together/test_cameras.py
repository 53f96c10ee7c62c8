"""Two cameras on one flange: simulated sessions with true corners, noise on corners and on the arm's reports."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import model
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.handeye.surface import FLAT
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.calib.together.cameras import Cameras, calibrate_cameras
from koala3d.calib.together.model import JointMeasurements, JointState
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError

ARM = Accuracy(5e-5, float(np.deg2rad(0.01)))
LEFT, RIGHT = KOALA.camera, Camera(1280, 960, 1150.0, 1152.0, 636.0, 483.0, -0.05, 0.02, 0.0002, 0.0003, 0.0)
FLANGE_FROM_LEFT = KOALA.flange_from_camera
LEFT_FROM_RIGHT = pose.from_rotation_vector([0.01, -0.12, 0.02], [0.06, 0.001, -0.003])
MOUNTS = (FLANGE_FROM_LEFT, FLANGE_FROM_LEFT @ LEFT_FROM_RIGHT)
PATTERN = ViewRange(tilt_deg=(0, 35), distance_m=(0.35, 0.5))


def simulated(seed: int, *, views: int = 20, same_stops: bool, sigma_px: float = 0.1, arm: Accuracy = ARM) -> list[TargetSession]:
    """A session of each camera; at the same stops they share the arm's report and its error."""
    rng = np.random.default_rng([12, seed])
    found = []
    for camera, mount in zip((LEFT, RIGHT), MOUNTS, strict=True):
        if not (same_stops and found):
            true = viewpoints(rng, KOALA, views, PATTERN) @ pose.inverse(FLANGE_FROM_LEFT)
            errors = rng.normal(size=(views, 6)) * np.repeat([arm.translation_m, arm.rotation_rad], 3)
            reported = true @ pose.inverse(pose.from_rotation_vector(errors[:, 3:], errors[:, :3]))
        observations = []
        for index, flange in enumerate(true):
            camera_from_board = pose.inverse(flange @ mount) @ KOALA.base_from_board
            pixels = camera.project(KOALA.board.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
            seen = np.flatnonzero(((pixels > 2) & (pixels < [camera.width - 2, camera.height - 2])).all(1))
            noisy = pixels[seen] + rng.normal(0, 1, (len(seen), 2)) * sigma_px
            observations.append(Observation(f"{index:03d}", seen, noisy, KOALA.board.points[seen]))
        found.append(TargetSession(KOALA.board, camera.width, camera.height, tuple(observations), reported))
    return found


def error(found: Cameras) -> np.ndarray:
    """(6,) error of the right camera's pose in the left one's frame."""
    motion = LEFT_FROM_RIGHT @ pose.inverse(found.first_from_camera[0].matrix)
    return np.concatenate([motion[:3, 3], pose.rotation_vector(motion[:3, :3])])


@pytest.fixture(scope="module")
def stereo() -> Cameras:
    return calibrate_cameras(simulated(1, same_stops=True), ["left", "right"], same_stops=True)


@pytest.fixture(scope="module")
def one_after_the_other() -> Cameras:
    return calibrate_cameras(simulated(1, same_stops=False), ["left", "right"])


def test_derivatives_agree_with_central_differences() -> None:
    rng = np.random.default_rng(4)
    bent = replace(ARM, stretch=1e-3, sag_m=1e-3)
    sessions = [model.measured(one, ("fx", "k1"), None, bent) for one in simulated(2, views=4, same_stops=True)]
    sessions.append(replace(sessions[0], points=0.5 * sessions[0].points))  # another target, half as large, the left one's
    stops = (np.arange(4), np.array([0, 1, 2, 4]), np.array([5, 1, 2, 3]))
    problem = JointMeasurements(tuple(sessions), (0, 1, 0), (0, 0, 1), stops, (1.0, 2.0))
    boards = KOALA.base_from_board, pose.from_rotation_vector([0, 0.02, 0], [0.02, 0, 0]) @ KOALA.base_from_board
    start = JointState(
        (projection.vector(LEFT), projection.vector(RIGHT)), MOUNTS, boards, 2 * (FLAT,), 1e-3 * rng.normal(size=(6, 6))
    )
    _, by_global, by_stop = problem.predicted(start)
    still, none, step = np.zeros((6, 6)), np.zeros(problem.unknowns), 1e-6
    for unknown in range(problem.unknowns):
        moved = [problem.moved(start, sign * step * (none + np.eye(len(none))[unknown]), still) for sign in (1, -1)]
        numeric = (problem.predicted(moved[0])[0] - problem.predicted(moved[1])[0]) / (2 * step)
        np.testing.assert_allclose(by_global[..., unknown], numeric, rtol=1e-5, atol=1e-4 * np.abs(by_global).max() / 1e3)
    for unknown in range(6):
        moved = [problem.moved(start, none, still + sign * step * np.eye(6)[unknown]) for sign in (1, -1)]
        numeric = (problem.predicted(moved[0])[0] - problem.predicted(moved[1])[0]) / (2 * step)
        np.testing.assert_allclose(by_stop[..., unknown], numeric, rtol=1e-5, atol=1e-2)  # pixels per metre: thousands


def test_without_noise_the_truth_is_found() -> None:
    sessions = simulated(3, same_stops=True, sigma_px=1e-4, arm=Accuracy(1e-9, 1e-9))
    found = calibrate_cameras(sessions, ["left", "right"], same_stops=True)
    assert np.abs(error(found)[:3]).max() < 1e-6 and np.abs(error(found)[3:]).max() < 1e-6
    for calibration, mount in zip(found.calibrations, MOUNTS, strict=True):
        np.testing.assert_allclose(calibration.flange_from_camera.matrix, mount, atol=1e-6)


def test_at_the_same_stops_the_arms_error_drops_out(stereo, one_after_the_other) -> None:
    """Half of the position's error is gone; that of the rotation is the principal points', which the arm has no part in."""
    assert (stereo.stops, stereo.shared) == (20, 20) and (one_after_the_other.stops, one_after_the_other.shared) == (40, 0)
    shared, apart = stereo.first_from_camera[0].total_std, one_after_the_other.first_from_camera[0].total_std
    assert shared[0] < 0.7 * apart[0] and shared[1] < apart[1]


@pytest.mark.parametrize("kind", ["stereo", "one_after_the_other"])
def test_the_error_is_within_what_is_stated(kind, request) -> None:
    found = request.getfixturevalue(kind)
    difference = error(found)
    squared = difference @ np.linalg.solve(found.first_from_camera[0].covariance, difference)
    assert squared < chi2.ppf(0.999, 6)


def test_both_cameras_hold_one_pose_of_the_target_that_is_no_worse_than_that_of_one(stereo) -> None:
    left, right = stereo.calibrations
    np.testing.assert_allclose(left.base_from_board.matrix, right.base_from_board.matrix, atol=1e-12)
    alone = calibrate.calibrate_handeye(simulated(1, same_stops=True)[0])
    assert left.base_from_board.total_std[0] < 1.02 * alone.base_from_board.total_std[0]  # sigmas are estimated anew


def test_a_target_that_was_moved_is_named() -> None:
    left, right = simulated(5, same_stops=False)
    moved = pose.from_rotation_vector([0.0, 0.0, 0.01], [0.003, 0.0, 0.0])
    right = replace(right, base_from_flange=moved @ right.base_from_flange)
    with pytest.raises(
        CalibrationError, match=r"target was moved .*left and right put it .* mm and .* deg apart, where .*stated"
    ):
        calibrate_cameras([left, right], ["left", "right"])


def test_sessions_that_do_not_belong_together_are_refused() -> None:
    left, right = simulated(6, same_stops=False)
    with pytest.raises(UsageError, match=r"right: views of one name .*arm reported another pose than in left.*--same-stops"):
        calibrate_cameras([left, right], ["left", "right"], same_stops=True)
    with pytest.raises(UsageError, match="by 'calib handeye'"):
        calibrate_cameras([left], ["left"])
    with pytest.raises(UsageError, match="right: one camera is on the flange and one beside"):
        calibrate_cameras([left, replace(right, eye_to_hand=True)], ["left", "right"])


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("same_stops", [True, False])
def test_errors_over_many_rigs_are_those_stated(same_stops: bool) -> None:
    """60 rigs: the mean squared distance over the six unknowns has a standard deviation of 7 %."""
    squared, ratio = [], []
    for seed in range(60):
        found = calibrate_cameras(simulated(100 + seed, same_stops=same_stops), ["left", "right"], same_stops=same_stops)
        between, difference = found.first_from_camera[0], error(found)
        squared.append(difference @ np.linalg.solve(between.covariance, difference) / 6)
        ratio.append(difference**2 / np.diag(between.covariance))
    print(f"\nsame stops {same_stops}: squared distance {np.mean(squared):.2f}, rms over stated {np.sqrt(np.mean(ratio)):.3f}")
    assert 0.8 < np.mean(squared) < 1.25
