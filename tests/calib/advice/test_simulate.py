import numpy as np

from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.handeye import model
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import bundle
from koala3d.datasets import pose


def draw(pattern=None, sigma_px=0.0, arm=None, seed=0, views=12):
    rng = np.random.default_rng(seed)
    return simulate(
        rng, KOALA, viewpoints(rng, KOALA, views, pattern or ViewRange()), sigma_px=sigma_px, arm=arm or Accuracy(1e-4, 1e-3)
    )


def test_views_keep_to_their_pattern():
    pattern = ViewRange((10.0, 30.0), (0.3, 0.4), (-5.0, 5.0), 0.0)
    drawn = viewpoints(np.random.default_rng(0), KOALA, 200, pattern)
    in_board = pose.inverse(KOALA.base_from_board) @ drawn
    tilt = np.rad2deg(np.arccos(in_board[:, 2, 2]))
    assert 10 <= tilt.min() < 12 and 28 < tilt.max() <= 30
    middle = np.append(KOALA.board.points[:, :2].mean(0), 0)
    distance = np.linalg.norm(in_board[:, :3, 3] - middle, axis=1)
    assert 0.3 <= distance.min() < 0.31 and 0.39 < distance.max() <= 0.4
    assert (drawn[:, 2, 3] > 0.2).all()  # above the table, on which the board lies face up


def test_the_truth_predicts_noise_free_corners():
    drawn = draw()
    np.testing.assert_allclose(model.predict(drawn.session, drawn.truth)[0], drawn.session.pixels, atol=1e-8)


def test_noise_is_what_was_asked_for():
    drawn = draw(sigma_px=0.3, views=60)
    noise = drawn.session.pixels - model.predict(drawn.session, drawn.truth)[0]
    assert abs(noise.std() / 0.3 - 1) < 0.05  # 60 * 48 * 2 numbers: 0.9 % one sigma
    assert abs(drawn.truth.corrections[:, :3].std() / 1e-4 - 1) < 0.25  # 180 numbers: 5 %


def test_observations_are_the_same_corners_by_view():
    drawn = draw(sigma_px=0.1)
    observations = drawn.observations()
    assert sum(len(o.ids) for o in observations) == len(drawn.session.view)
    np.testing.assert_array_equal(KOALA.board.points[observations[3].ids], observations[3].points)


def test_board_poses_come_back_from_corners():
    drawn = draw()
    session = drawn.session
    off = pose.from_rotation_vector([0.02, -0.01, 0.03], [1e-3, 2e-3, -5e-3])
    corners = bundle.Corners(session.view, session.pixels, session.points)
    found = bundle.fit(corners, drawn.truth.intrinsics, drawn.camera_from_board @ off)
    np.testing.assert_allclose(found.camera_from_board, drawn.camera_from_board, atol=1e-9)
