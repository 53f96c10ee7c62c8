from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.advice import information
from koala3d.calib.advice.information import Knowledge
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA
from koala3d.calib.handeye import model, refine
from koala3d.calib.handeye.model import Accuracy, Measurements, State
from koala3d.calib.handeye.refine import Sigmas
from koala3d.calib.intrinsics import projection
from koala3d.datasets import pose
from koala3d.datasets.calibration import UncertainPose

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
SIGMAS = Sigmas(0.1, 5e-5, 2e-4)


@pytest.fixture(scope="module")
def known() -> Knowledge:
    state = State(projection.vector(KOALA.camera), KOALA.flange_from_camera, KOALA.base_from_board, np.zeros((1, 6)))
    return Knowledge(KOALA.camera, KOALA.board, FREE, state, SIGMAS, np.eye(20))


def flanges(count: int) -> np.ndarray:
    return viewpoints(np.random.default_rng(0), KOALA, count, ViewRange()) @ pose.inverse(KOALA.flange_from_camera)


def test_each_view_tells_what_the_refinement_says_of_it_alone(known):
    flown = flanges(information.BLOCK + 3)
    told = information.informations(known, flown)
    for index in (0, 7, len(flown) - 1):
        points = KOALA.board.points
        session = Measurements(flown[index][None], np.zeros(len(points), np.int64), np.zeros((len(points), 2)), points, FREE)
        session = replace(session, accuracy=Accuracy(SIGMAS.translation_m, SIGMAS.rotation_rad))
        pixels = model.predict(session, known.state)[0]
        seen = replace(session, pixels=pixels).some(information.inside_image(pixels, KOALA.camera))
        reference = refine.linear_system(seen, known.state, SIGMAS).information
        np.testing.assert_allclose(told[index], reference, rtol=1e-6, atol=1e-9 * np.abs(reference).max())


def test_views_that_show_too_little_tell_nothing(known):
    flown = flanges(3)
    away = flown.copy()
    away[1] = flown[1] @ pose.from_rotation_vector([np.pi, 0, 0])  # looks the other way: corners behind the camera
    aside = flown[2].copy()
    aside[:3, 3] += [0.4, 0, 0]  # as far as the board is away
    away[2] = aside
    told = information.informations(known, away)
    assert told[0] is not None and told[1] is None and told[2] is None
    assert information.informations(known, away[1:2]) == [None]


def test_figures_hold_gaussian_errors_with_the_stated_certainty():
    rng = np.random.default_rng(1)
    for _ in range(5):
        root = rng.normal(size=(6, 6)) * np.repeat([2e-5, 1e-4], 3)[:, None] * rng.uniform(0.1, 3, 6)
        millimetres, degrees = information.limits(root @ root.T)
        drawn = rng.normal(size=(100_000, 6)) @ root.T
        inside_mm = np.mean(1e3 * np.linalg.norm(drawn[:, :3], axis=1) <= millimetres)
        inside_deg = np.mean(np.rad2deg(np.linalg.norm(drawn[:, 3:], axis=1)) <= degrees)
        # each figure: (1 + 0.95) / 2; the replaced distribution is right to half a percent, the draws to 0.05
        assert abs(inside_mm - 0.975) < 0.006 and abs(inside_deg - 0.975) < 0.006


def test_translation_is_that_of_the_cameras_centre(known):
    root = np.random.default_rng(2).normal(size=(6, 6)) * 1e-4
    covariance = root @ root.T
    moved = information.at_the_pose(covariance, known.state)
    stated = UncertainPose(known.state.mount_from_camera, covariance)
    np.testing.assert_allclose(1e3 * np.sqrt(np.diag(moved)[:3]), stated.translation_std_mm)
    np.testing.assert_allclose(moved[3:, 3:], covariance[3:, 3:])
