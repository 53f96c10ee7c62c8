import numpy as np
import pytest

from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.intrinsics import bundle, projection
from koala3d.datasets import pose

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def draw(sigma_px, seed=0):
    rng = np.random.default_rng(seed)
    return simulate(rng, KOALA, viewpoints(rng, KOALA, 12, ViewRange()), sigma_px=sigma_px, arm=Accuracy(1e-5, 1e-5))


def test_camera_and_poses_come_back_from_noise_free_corners():
    drawn = draw(0.0)
    start = drawn.truth.intrinsics + np.array([20, -20, 10, -10, 0.02, 0, 0, 0, 0, 0, 0, 0])
    s = drawn.session
    found = bundle.fit(bundle.Corners(s.view, s.pixels, s.points), start, drawn.camera_from_board, FREE)
    np.testing.assert_allclose(found.intrinsics, projection.vector(KOALA.camera), atol=1e-5)
    assert np.abs(found.residuals).max() < 1e-6


def test_errors_are_those_that_the_information_states():
    squares = []
    for seed in range(40):
        drawn = draw(0.2, seed)
        s = drawn.session
        found = bundle.fit(bundle.Corners(s.view, s.pixels, s.points), drawn.truth.intrinsics, drawn.camera_from_board, FREE)
        error = (found.intrinsics - drawn.truth.intrinsics)[:8]
        squares.append(error @ found.information @ error / 0.2**2)
    # chi-square of 8: mean 8, over 40 sessions with a deviation of sqrt(16 / 40) = 0.63
    assert np.mean(squares) == pytest.approx(8, abs=2)


def test_a_board_behind_the_camera_is_an_error():
    drawn = draw(0.0)
    s = drawn.session
    with pytest.raises(CalibrationError, match="behind the camera"):
        behind = pose.from_rotation_vector([np.pi, 0, 0]) @ drawn.camera_from_board
        bundle.fit(bundle.Corners(s.view, s.pixels, s.points), drawn.truth.intrinsics, behind)
