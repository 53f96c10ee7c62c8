"""The camera stands beside the arm, the board is on the flange."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice.adviser import Adviser, Wanted
from koala3d.calib.advice.hints import hints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.errors import Unobservable
from koala3d.calib.handeye import model, refine, uncertainty, verify
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.intrinsics import projection
from koala3d.calib.sessions.session import TargetSession
from koala3d.calib.targets.detection import Observation
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.targets.board import Board

BOARD = Board.of("charuco", 9, 7, 0.02, 0.0146)
BASE_FROM_CAMERA = pose.look_at((1.1, 0.1, 0.5), (0.5, 0.0, 0.4))
FLANGE_FROM_BOARD = pose.from_rotation_vector([0.1, np.pi, 0.2], [0.05, -0.02, 0.06])
ARM = Accuracy(5e-5, float(np.deg2rad(0.01)))


def simulated(seed, views=25, sigma_px=0.1, arm=ARM):
    """(session, true corrections): the board is turned before the camera."""
    rng, camera = np.random.default_rng([6, seed]), KOALA.camera
    middle = np.append(BOARD.points[:, :2].mean(0), 0)
    observations, reported, errors = [], [], rng.normal(size=(views, 6)) * np.repeat([arm.translation_m, arm.rotation_rad], 3)
    for index in range(views):
        turn = pose.from_rotation_vector(rng.normal(0, 0.35, 3)) @ pose.from_rotation_vector([0, 0, rng.uniform(-np.pi, np.pi)])
        camera_from_board = turn.copy()
        camera_from_board[:3, 3] = [0, 0, rng.uniform(0.4, 0.6)] - turn[:3, :3] @ middle + rng.uniform(-0.03, 0.03, 3)
        true = BASE_FROM_CAMERA @ camera_from_board @ pose.inverse(FLANGE_FROM_BOARD)
        reported.append(true @ pose.inverse(model.perturbed(np.eye(4), errors[index])))
        pixels = camera.project(BOARD.points @ camera_from_board[:3, :3].T + camera_from_board[:3, 3])
        observations.append(
            Observation(
                f"{index:03d}",
                np.arange(48),
                pixels + rng.normal(0, sigma_px, pixels.shape) if sigma_px else pixels,
                BOARD.points,
            )
        )
    session = TargetSession(BOARD, camera.width, camera.height, tuple(observations), np.stack(reported), eye_to_hand=True)
    return session, errors


def test_noise_free_corners_are_predicted_exactly():
    session, errors = simulated(0, sigma_px=0)
    measured = model.measured(session, (), None, ARM)
    state = State(projection.vector(KOALA.camera), BASE_FROM_CAMERA, FLANGE_FROM_BOARD, errors)
    np.testing.assert_allclose(model.predict(measured, state)[0], measured.pixels, atol=1e-8)


def test_jacobian_agrees_with_central_differences():
    session, errors = simulated(1, views=6)
    measured: Measurements = model.measured(session, ("fx", "k1"), None, ARM)
    state = State(projection.vector(KOALA.camera), BASE_FROM_CAMERA, FLANGE_FROM_BOARD, 1e3 * errors)
    _, by_global, by_view = model.predict(measured, state)
    none = np.zeros((6, 6))
    for index in range(by_global.shape[-1]):
        step = 1e-6 * np.eye(by_global.shape[-1])[index]
        numeric = (
            model.predict(measured, measured.moved(state, step, none))[0]
            - model.predict(measured, measured.moved(state, -step, none))[0]
        ) / 2e-6
        np.testing.assert_allclose(by_global[..., index], numeric, rtol=1e-5, atol=2e-3)
    for index in range(6):
        step = np.zeros((6, 6))
        step[:, index] = 1e-6
        ahead, behind = (model.predict(measured, replace(state, corrections=state.corrections + s * step))[0] for s in (1, -1))
        np.testing.assert_allclose(by_view[..., index], (ahead - behind) / 2e-6, rtol=1e-5, atol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_camera_s_place_is_found_within_its_uncertainty(seed):
    session, _ = simulated(10 + seed)
    found = calibrate.calibrate_handeye(session, accuracy=ARM)
    assert found.flange_from_camera is None
    for value, truth in ((found.base_from_camera, BASE_FROM_CAMERA), (found.flange_from_board, FLANGE_FROM_BOARD)):
        perturbation = truth @ pose.inverse(value.matrix)
        error = np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])
        assert error @ np.linalg.solve(value.covariance, error) < 30  # chi-square of 6: once in 25000
    distance, _ = pose.difference(found.base_from_camera.matrix, BASE_FROM_CAMERA)
    assert distance < 1e-3


def test_it_survives_its_file_and_verifies_another_session(tmp_path):
    found = calibrate.calibrate_handeye(simulated(20)[0], accuracy=ARM)
    found.save(tmp_path / "c.json")
    again = Calibration.load(tmp_path / "c.json")
    np.testing.assert_allclose(again.base_from_camera.matrix, found.base_from_camera.matrix, atol=1e-12)
    result = verify.verify(simulated(21)[0], again)
    assert result.rms_mm < 0.3


def test_a_pose_that_no_view_shows_is_named_as_it_is_here():
    session, errors = simulated(40, views=6)
    measured = model.measured(session, (), None, ARM)
    state = State(projection.vector(KOALA.camera), BASE_FROM_CAMERA, FLANGE_FROM_BOARD, errors)
    refined = refine.refine(measured, state, sigma_px=0.1)
    information = refined.information.copy()
    information[2, :] = information[:, 2] = 0.0
    with pytest.raises(Unobservable, match="base_from_camera translation z is not observable"):
        uncertainty.covariance(measured, replace(refined, information=information))


def test_the_adviser_chooses_views_with_the_camera_beside_the_arm():
    session, _ = simulated(50)
    by_ruler = model.perturbed(BASE_FROM_CAMERA, np.array([3e-3, -2e-3, 4e-3, 0.01, 0.02, -0.01]))
    adviser = Adviser(Wanted((0.05, 0.01), by_ruler, ARM))
    adviser.update(session.chosen(np.arange(25) < 3))
    assert adviser.figures is None and adviser.known.eye_to_hand
    assert all(one is not None for one in adviser.expected(session.base_from_flange))
    adviser.update(session.chosen(np.arange(25) < 15))
    now, after = adviser.figures, adviser.expected(session.base_from_flange[15:])
    assert now is not None and all(one is not None and one[0] < now[0] and one[1] < now[1] for one in after)
    assert adviser.expected(pose.rigid(np.eye(3), [0, 1.0, 0]) @ session.base_from_flange[:1]) == [None]  # out of the picture
    assert hints(adviser.known, session.base_from_flange, now, (0.05, 0.01))
    assert adviser.calibration().base_from_camera is not None


def test_a_wrong_view_is_left_out():
    session, _ = simulated(30)
    reported = session.base_from_flange.copy()
    reported[4, :3, 3] += [0.01, 0, 0]
    found = calibrate.calibrate_handeye(replace(session, base_from_flange=reported), accuracy=ARM)
    assert found.residuals.views_left_out == ["004"]
