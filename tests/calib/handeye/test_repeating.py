"""Errors of the arm that are the same at the same place."""

from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.advice.rehearsal import draw_rig
from koala3d.calib.errors import Unobservable
from koala3d.calib.handeye import model, refine, repeating, uncertainty
from koala3d.calib.handeye.model import Accuracy, State
from koala3d.calib.intrinsics import projection
from koala3d.datasets import kinematics, pose
from koala3d.datasets.kinematics import UR5E
from tests.calib import drawn_arms

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def solved(scale, seed=0, views=25):
    """(rig, session, refinement) of an arm whose links are off by `scale`."""
    rng, rig = np.random.default_rng([seed, 51]), draw_rig(seed)
    links = UR5E.calibrated(rng, scale * repeating.LENGTH_M, scale * repeating.ANGLE_RAD)
    found = drawn_arms.drawn(rng, rig, links, views)
    session = model.measured(found, FREE, None, Accuracy())
    start = State(projection.vector(rig.camera), rig.flange_from_camera, rig.base_from_board, np.zeros((views, 6)))
    return rig, session, refine.refine(session, start, sigma_px=0.1)


def deviation(session, refined, covariance):
    """Standard deviations of the camera's pose [mm], [deg]."""
    return np.array(uncertainty.poses(session, refined, covariance)[0].total_std)


@pytest.fixture(scope="module")
def exact():
    return solved(0.0)


@pytest.fixture(scope="module")
def bent():
    return solved(1.0)


def test_without_errors_that_repeat_the_covariance_is_the_inverse_of_the_information(exact):
    _, session, refined = exact
    views = repeating._views(session, refined)
    stop = np.array([refined.sigmas.translation_m, refined.sigmas.rotation_rad])
    found, expected = views.covariance(refined.sigmas, stop, 0.0), uncertainty.covariance(session, refined)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-5)


def test_likelihood_is_that_of_all_corrections_with_their_full_covariance(exact):
    """The slow way: one large normal distribution, from which the global unknowns are removed by an orthogonal projection."""
    _, session, refined = exact
    views = repeating._views(session, refined)
    rows = np.vstack([views.by_global.reshape(-1, views.by_global.shape[-1]), views.root])
    rows /= np.linalg.norm(rows, axis=0)  # the units of the unknowns change the likelihood by a constant
    values = np.concatenate([views.asked.ravel(), views.side])
    left = np.linalg.qr(rows, mode="complete")[0][:, rows.shape[1] :]
    stated = np.array([views.stated.translation_m, views.stated.rotation_rad])

    def slowly(stop, scale):
        count = views.asked.size
        whole = np.eye(len(values))
        whole[:count, :count] = 0.0
        for i, noise in enumerate(views.noise(stop)):
            whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = noise
        moved = scale * views.repeating.reshape(count, -1)
        whole[:count, :count] += moved @ moved.T
        covariance, seen = left.T @ whole @ left, left.T @ values
        prior = 12 * (np.log(stop / stated) + 0.5 * (stated / stop) ** 2).sum()
        return -0.5 * (seen @ np.linalg.solve(covariance, seen) + np.linalg.slogdet(covariance)[1]) - prior

    tried = [(stated, 0.0), (0.5 * stated, 0.1), (2 * stated, 1.0)]
    fast, slow = ([likelihood(*one) for one in tried] for likelihood in (views.likelihood, slowly))
    np.testing.assert_allclose(np.diff(fast), np.diff(slow), rtol=1e-3)


def test_an_arm_that_repeats_nothing_is_told_so(exact):
    _, session, refined = exact
    found = repeating.estimate(session, refined)
    independent = uncertainty.covariance(session, refined)
    assert found.scale < 0.05 and 0.02e-3 < found.stop_m < 0.06e-3
    assert (deviation(session, refined, found.covariance) < 1.15 * deviation(session, refined, independent)).all()


def test_links_that_are_off_are_measured_and_stated(bent):
    rig, session, refined = bent
    found = repeating.estimate(session, refined)
    assert 0.4 < found.scale < 2.5 and 0.02e-3 < found.stop_m < 0.08e-3  # the stop is found behind errors of a millimetre
    independent, camera = uncertainty.covariance(session, refined), uncertainty.poses(session, refined, found.covariance)[0]
    assert (deviation(session, refined, found.covariance) > 2 * deviation(session, refined, independent)).all()
    assert drawn_arms.squared_distance(camera, rig.flange_from_camera) < 22.5  # the 99.9 % point
    before = uncertainty.poses(session, refined, independent)[0]
    assert drawn_arms.squared_distance(before, rig.flange_from_camera) > 22.5


def test_without_joint_angles_neighbouring_poses_err_alike(bent):
    rig, session, refined = bent
    session = replace(session, joints=None)
    found = repeating.estimate(session, refined)
    assert found.scale > 0.3
    covariances = found.covariance, uncertainty.covariance(session, refined)
    widened, before = (
        drawn_arms.squared_distance(uncertainty.poses(session, refined, each)[0], rig.flange_from_camera) for each in covariances
    )
    assert widened < before / 2  # a smooth function is not what links do: 28 where 22.5 is the 99.9 % point, instead of 84


def test_smooth_errors_have_the_stated_size_and_fade_with_distance():
    still = np.tile(np.eye(4), (3, 1, 1))
    still[1, 0, 3], still[2, 0, 3] = 0.3, 3.0
    motions = repeating._smooth(still)
    covariance = np.einsum("nik,mjk->nmij", motions, motions)
    size = np.repeat([repeating.LENGTH_M, repeating.ANGLE_RAD], 3) ** 2
    np.testing.assert_allclose(covariance[0, 0], np.diag(size), atol=1e-3 * size.max())
    np.testing.assert_allclose(np.diag(covariance[0, 1]), np.exp(-0.5) * size, rtol=1e-3)
    assert np.abs(covariance[0, 2]).max() < 1e-3 * size.max()


def test_angles_of_another_arm_are_not_used(exact):
    _, session, _ = exact
    other = replace(session, joints=np.zeros_like(session.joints))
    np.testing.assert_array_equal(repeating.motions(other), repeating.motions(replace(session, joints=None)))
    assert repeating.motions(session).shape == (25, 6, 24)


def test_drawn_angles_lead_to_the_poses():
    rng, rig = np.random.default_rng(0), draw_rig(1)
    session = drawn_arms.drawn(rng, rig, UR5E, 5)
    distance, angle = pose.difference(kinematics.forward(session.joints), session.base_from_flange)
    assert distance.max() < 1e-9 and angle.max() < 1e-9


def test_the_arm_is_off_by_what_its_links_are():
    """Reported and true poses of a session differ as those of the two arms do, beside the error of each stop."""
    rig, links = draw_rig(0), UR5E.calibrated(np.random.default_rng(1), repeating.LENGTH_M, repeating.ANGLE_RAD)
    session = drawn_arms.drawn(np.random.default_rng(2), rig, links, 6)
    built = kinematics.forward(session.joints, links)
    apart, _ = pose.difference(built, session.base_from_flange)
    assert 2e-4 < np.median(apart) < 1e-2
    for flange, observation in zip(built, session.observations, strict=True):
        board = pose.inverse(flange @ rig.flange_from_camera) @ rig.base_from_board
        off = observation.pixels - rig.camera.project(observation.points @ board[:3, :3].T + board[:3, 3])
        assert np.sqrt((off**2).mean()) < 1.0  # a stop of 0.03 mm and corners; links as reported would be several pixels off


def test_views_that_leave_something_undetermined_are_refused_in_one_line(simulate, make_viewpoints):
    found = simulate(seed=0, poses=lambda rng: np.repeat(make_viewpoints(rng, 1), 2, axis=0))
    session = found.session(free=FREE[:4], known=None, accuracy=Accuracy())
    refined = refine.refine(session, found.state(), sigma_px=0.1)
    with pytest.raises(Unobservable, match=r"hand-eye pose are not observable \(2 views\)"):
        repeating.estimate(session, refined)
