from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import model
from koala3d.calib.intrinsics import projection
from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera


@pytest.fixture
def bent(small):
    """A session with all parameters free and large corrections, so that no term of the derivative is nearly zero."""
    session = small.session(free=projection.NAMES)
    rng = np.random.default_rng(5)
    corrections = rng.normal(0, 1, (12, 6)) * np.repeat([0.01, 0.1], 3)
    return session, replace(small.state(), corrections=corrections)


def test_predicts_along_the_chain_of_frames(small):
    session, state = small.session(), small.state()
    rng = np.random.default_rng(1)
    state = replace(state, corrections=rng.normal(0, 0.01, (12, 6)))
    pixels, _, _ = model.predict(session, state)
    camera = projection.with_vector(Camera(960, 600, 1, 1, 0, 0), state.intrinsics)
    for k in range(0, len(session.view), 37):  # the slow, obvious way
        i = session.view[k]
        correction = pose.from_rotation_vector(state.corrections[i, 3:], state.corrections[i, :3])
        base_from_camera = session.base_from_flange[i] @ correction @ state.mount_from_camera
        point = pose.inverse(base_from_camera) @ state.stand_from_board @ [*session.points[k], 1]
        np.testing.assert_allclose(pixels[k], camera.project(point[:3]), atol=1e-9)
        np.testing.assert_allclose(model.camera_points(session, state)[k], point[:3], atol=1e-12)


def test_jacobian_agrees_with_central_differences(bent):
    session, state = bent
    _, by_global, by_view = model.predict(session, state)
    columns, none = session.columns, np.zeros((12, 6))
    # steps of 1e-6 in all: truncation below 1e-7 of the derivative, rounding below 1e-13 * 1e3 / 1e-6 px
    tolerance = {"rtol": 1e-5, "atol": 1e-3}
    for index in range(len(columns) + 12):
        step = 1e-6 * np.eye(len(columns) + 12)[index]
        ahead = model.predict(session, session.moved(state, step, none))[0]
        behind = model.predict(session, session.moved(state, -step, none))[0]
        np.testing.assert_allclose(by_global[..., index], (ahead - behind) / 2e-6, **tolerance)
    for index in range(6):
        step = np.zeros((12, 6))
        step[:, index] = 1e-6  # all views at once: a correction touches its own view alone
        ahead = model.predict(session, replace(state, corrections=state.corrections + step))[0]
        behind = model.predict(session, replace(state, corrections=state.corrections - step))[0]
        np.testing.assert_allclose(by_view[..., index], (ahead - behind) / 2e-6, **tolerance)


def test_perturbation_moves_about_the_first_frame():
    a_from_b = pose.from_rotation_vector([0.1, 0.2, 0.3], [0.5, 0.0, 0.0])
    moved = model.perturbed(a_from_b, np.array([0.0, 0.0, 0.01, 0.0, 0.0, 1e-3]))
    np.testing.assert_allclose(moved[:3, 3] - a_from_b[:3, 3], [-0.25e-6, 0.5e-3, 0.01], atol=1e-9)


def test_a_target_behind_the_camera_is_an_error(small):
    behind = replace(small.state(), mount_from_camera=small.flange_from_camera @ pose.from_rotation_vector([np.pi, 0, 0]))
    with pytest.raises(CalibrationError, match="behind the camera"):
        model.predict(small.session(), behind)
