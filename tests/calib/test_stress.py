"""Extremes: the answer is right, or it is refused with a reason; never NaN, never a wrong answer that looks certain."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.errors import CalibrationError, Unobservable
from koala3d.calib.handeye import closed_forms, uncertainty
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.targets.board import Board

ARM = Accuracy(3e-5, float(np.deg2rad(0.005)))
BOARD = Board.of("charuco", 8, 6, 0.045, 0.033)
RIG = replace(KOALA, board=BOARD)
slow = partial(pytest.param, marks=pytest.mark.slow)
"""A case between others that `make test` runs."""


def outcome(simulated, *, given=True, reported=None, arm=ARM):
    """What `calib handeye` answers: a calibration whose every number is finite, or the error in words."""
    camera = simulated.rig.camera
    poses = simulated.session.base_from_flange if reported is None else reported
    session = TargetSession(simulated.rig.board, camera.width, camera.height, tuple(simulated.observations()), poses)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # overflow, division by zero, invalid values
        try:
            found = calibrate.calibrate_handeye(session, Calibration(camera, {}) if given else None, arm)
        except KoalaError as error:
            assert len(str(error)) > 30 and "nan" not in str(error).lower(), "a refusal has to give its reason"
            return str(error)
    for uncertain in (found.flange_from_camera, found.base_from_board):
        assert np.isfinite(uncertain.matrix).all() and np.isfinite(uncertain.covariance).all()
        least, *_, most = np.linalg.eigvalsh(uncertain.covariance)
        assert least > -1e-14 * most, "rounding alone"
    return found


def assert_right(found, simulated, sigmas=5.5):
    """Within the stated region: six degrees of freedom, beyond 5.5 deviations once in a hundred thousand sessions."""
    perturbation = simulated.truth.mount_from_camera @ pose.inverse(found.flange_from_camera.matrix)
    error = np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])
    distance = np.sqrt(error @ np.linalg.solve(found.flange_from_camera.covariance, error))
    assert distance < sigmas, f"{distance:.1f} deviations off"


def right_or_refused(found, simulated):
    """True where the answer is right, False where there is none."""
    if isinstance(found, str):
        return False
    assert_right(found, simulated)
    return True


def draw(seed=0, rig=RIG, pattern=None, views=15, sigma_px=0.1, arm=ARM):
    rng = np.random.default_rng([8, seed])
    return simulate(rng, rig, viewpoints(rng, rig, views, pattern or ViewRange()), sigma_px=sigma_px, arm=arm)


@pytest.mark.parametrize("angle", [1e-6, slow(1e-5), slow(1e-4), 1e-3, slow(1e-2), 0.05, 0.2, slow(0.5), 1.0])
def test_tilts_from_a_millionth_of_a_radian_on(angle):
    degrees = float(np.rad2deg(angle))
    simulated = draw(pattern=ViewRange((0.0, degrees), roll_deg=(-degrees, degrees)))
    assert right_or_refused(outcome(simulated), simulated) == (angle >= 0.2) or 0.01 <= angle < 0.2
    if angle <= 1e-3:
        assert "observable" in outcome(simulated)


@pytest.mark.parametrize("roll", [np.pi - 1e-9, slow(np.pi), slow(np.pi / 2), 1e-6])
def test_turns_up_to_half_a_turn(roll):
    """Views that differ by exactly half a turn: where rotation vectors flip their sign."""
    simulated = draw(seed=1)
    turned = simulated.base_from_camera.copy()
    turned[::2] = turned[::2] @ pose.from_rotation_vector([0, 0, roll])
    again = simulate(np.random.default_rng(5), RIG, turned, sigma_px=0.1, arm=ARM)
    assert right_or_refused(outcome(again), again)


@pytest.mark.parametrize("axis", [[np.pi, 0, 0], slow([0, np.pi, 0]), [0, 0, np.pi - 1e-12], slow([1e-6, 0, 0]), [0, 0, 0]])
def test_hand_eye_rotations_from_nothing_to_half_a_turn(axis):
    rig = replace(RIG, flange_from_camera=pose.from_rotation_vector(axis, [0.0, 0.06, 0.08]))
    simulated = draw(seed=2, rig=rig)
    assert right_or_refused(outcome(simulated), simulated)


@pytest.mark.parametrize("jitter", [0.0, 1e-12, 1e-9, 1e-6])
def test_one_pose_many_times_is_refused(jitter):
    simulated = draw(seed=3)
    rng = np.random.default_rng(0)
    same = simulated.base_from_camera[:1] @ pose.from_rotation_vector(rng.normal(0, 1, (15, 3)) * jitter)
    again = simulate(rng, RIG, same, sigma_px=0.1, arm=ARM)
    assert "observable" in outcome(again)


def test_two_poses_many_times_are_refused():
    simulated = draw(seed=4)
    again = simulate(np.random.default_rng(0), RIG, simulated.base_from_camera[np.arange(15) % 2], sigma_px=0.1, arm=ARM)
    assert "axis of rotation" in outcome(again)


def test_four_poses_many_times_are_worth_four():
    simulated = draw(seed=5, pattern=ViewRange((25.0, 45.0)))
    again = simulate(np.random.default_rng(0), RIG, simulated.base_from_camera[np.arange(15) % 4], sigma_px=0.1, arm=ARM)
    assert right_or_refused(outcome(again), again)


@pytest.mark.parametrize("focal", [1e2, slow(3e2), 1e3, slow(1e4), 1e5])
@pytest.mark.parametrize("given", [True, False], ids=["given", "estimated"])
def test_focal_lengths_of_a_hundred_to_a_hundred_thousand_pixels(focal, given):
    """The board fills the same share of the picture: the longer the lens, the further away it is."""
    distance = np.array([0.4, 0.6]) * focal / 1700
    rig = replace(RIG, camera=Camera(1920, 1080, focal, focal, 968.0, 534.0))
    simulated = draw(seed=6, rig=rig, pattern=ViewRange(distance_m=(max(distance[0], 0.15), max(distance[1], 0.25))), views=20)
    found = outcome(simulated, given=given)
    answered = right_or_refused(found, simulated)
    if given and 3e2 <= focal <= 1e4:
        assert answered, found


@pytest.mark.parametrize("width", [0.05, slow(0.2), slow(1.0), 5.0, 50.0])
def test_boards_of_five_centimetres_to_fifty_metres(width):
    scale = width / 0.36
    board = Board.of("charuco", 8, 6, 0.045 * scale, 0.033 * scale)
    simulated = draw(
        seed=7, rig=replace(RIG, board=board), pattern=ViewRange(distance_m=(0.4 * scale, 0.6 * scale), shift_m=0.03 * scale)
    )
    found = outcome(simulated)
    answered = right_or_refused(found, simulated)
    if width <= 5:
        assert answered, found


@pytest.mark.parametrize("offset", [slow([1e3, 0, 0]), [0, -1e3, 1e3], [1e6, 0, 0]])
def test_a_base_a_kilometre_away(offset):
    """The hand-eye pose does not depend on where the arm's base is."""
    simulated = draw(seed=8)
    moved = simulated.session.base_from_flange.copy()
    moved[:, :3, 3] += offset
    near, far = outcome(simulated), outcome(simulated, reported=moved)
    if np.abs(offset).max() > 1e5 and isinstance(far, str):
        return
    distance, angle = pose.difference(near.flange_from_camera.matrix, far.flange_from_camera.matrix)
    # a double holds a kilometre to 1e-13 m; solving costs some digits: a thousandth of the error itself
    assert distance < 1e-6 and angle < 1e-6
    assert_right(far, simulated)


@pytest.mark.parametrize("sigma_px", [0.0, slow(1e-6), 1e-3, 5.0])
@pytest.mark.parametrize(
    "arm",
    [
        pytest.param(Accuracy(1e-12, 1e-12), id="exact"),
        pytest.param(Accuracy(1e-9, 1e-9), id="nearly", marks=pytest.mark.slow),
        pytest.param(Accuracy(1e-2, 1e-2), id="poor"),
    ],
)
def test_perfect_and_terrible_measurements(sigma_px, arm):
    simulated = draw(seed=9, sigma_px=sigma_px, arm=arm)
    stated = Accuracy(max(arm.translation_m, 1e-7), max(arm.rotation_rad, 1e-7))
    found = outcome(simulated, arm=stated)
    if isinstance(found, str):
        assert arm.translation_m > 1e-3 or sigma_px >= 5, found
        return
    distance, angle = pose.difference(found.flange_from_camera.matrix, simulated.truth.mount_from_camera)
    bound = 1e-7 + 1e-4 * sigma_px + arm.translation_m
    assert distance < 20 * bound and angle < 20 * (1e-7 + 1e-4 * sigma_px + arm.rotation_rad)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_poses_that_are_no_numbers_are_refused_by_name(bad):
    simulated = draw(seed=10)
    broken = simulated.session.base_from_flange.copy()
    broken[3, 0, 3] = bad
    session = TargetSession(BOARD, 1920, 1080, tuple(simulated.observations()), broken)
    with pytest.raises(CalibrationError, match="view 003: arm's pose is not credible"):
        calibrate.calibrate_handeye(session)


def test_board_seen_edge_on_and_in_a_corner():
    simulated = draw(seed=11, pattern=ViewRange((75.0, 88.0)), views=15)
    right_or_refused(outcome(simulated), simulated)
    far = draw(seed=12, pattern=ViewRange(distance_m=(4.0, 6.0)))
    right_or_refused(outcome(far), far)


@pytest.mark.parametrize("method", closed_forms.METHODS)
@pytest.mark.parametrize("angle", [1e-6, 1e-3, np.pi - 1e-7])
def test_closed_forms_give_a_pose_or_an_error(method, angle):
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(8, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    flange = pose.from_rotation_vector(angle * axes, rng.normal(0, 0.3, (8, 3)))
    boards = pose.inverse(flange @ RIG.flange_from_camera) @ RIG.base_from_board
    try:
        found = closed_forms.solve(flange, boards, method)
    except KoalaError:
        return
    assert np.isfinite(found.mount_from_camera).all()
    np.testing.assert_allclose(found.mount_from_camera[:3, :3] @ found.mount_from_camera[:3, :3].T, np.eye(3), atol=1e-9)


def test_information_that_says_nothing_about_a_direction_is_refused_by_name():
    simulated = draw(seed=13, pattern=ViewRange((0.0, 0.0), roll_deg=(-180.0, 180.0)))
    with pytest.raises(Unobservable, match=r"along the axis of rotation"):
        uncertainty.check_motion(simulated.session.base_from_flange)
    with pytest.raises(CalibrationError):
        uncertainty.check_motion(simulated.session.base_from_flange[:2])
