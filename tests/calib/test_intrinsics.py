from dataclasses import replace

import numpy as np
import pytest

from calib import intrinsics, projection
from calib.errors import TargetError, Unobservable
from calib.model import camera_points
from datasets import pose
from datasets.camera_model import Camera

PLAIN = Camera(960, 600, 850.0, 848.0, 484.0, 296.0)
STRONG = Camera(960, 600, 560.0, 558.0, 484.0, 296.0, -0.30, 0.12, 0.001, -0.001, -0.02)


def test_true_values_lie_within_the_stated_deviations(simulate):
    session = simulate(seed=11, views=25)
    found = intrinsics.calibrate(session.observations, 960, 600)
    errors = [
        (getattr(found.camera, n) - getattr(session.camera, n)) / s for n, s in found.std.items() if n in ("fx", "fy", "cx", "cy")
    ]
    assert np.abs(errors).max() < 4  # four of them, Gaussian: once in 4000 seeds
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.05)
    assert found.held_out_px == pytest.approx(found.rms_px, rel=0.1)
    assert 0.5 < found.coverage <= 1


def test_half_pixel_is_ours(simulate):
    # without noise the centre comes back in our convention: half a pixel would be a hundred times the tolerance
    perfect = simulate(seed=12, views=12, noise_px=0, camera=PLAIN)
    found = intrinsics.calibrate(perfect.observations, 960, 600, models=[()])
    assert (found.camera.cx, found.camera.cy) == pytest.approx((484.0, 296.0), abs=5e-3)
    np.testing.assert_allclose(found.camera.fx, 850.0, atol=5e-3)  # OpenCV takes corners as float32


def test_a_lens_without_distortion_gets_no_more_than_it_shows(simulate):
    found = intrinsics.calibrate(simulate(seed=13, views=16, camera=PLAIN).observations, 960, 600)
    assert "k3" not in found.distortion and found.camera.k3 == 0
    corner = np.array([[0.0, 0.0], [960.0, 0.0], [960.0, 600.0]])
    # what is left of it moves the image's corner by less than a pixel
    np.testing.assert_allclose(PLAIN.project(found.camera.directions(corner)), corner, atol=1.0)


def test_a_strong_lens_gets_its_coefficients(simulate):
    found = intrinsics.calibrate(simulate(seed=14, views=25, camera=STRONG).observations, 960, 600)
    assert {"k1", "k2", "p1", "p2"} <= set(found.distortion)
    np.testing.assert_allclose([found.camera.k1, found.camera.k2], [-0.30, 0.12], atol=0.03)


def test_too_few_views_are_refused_with_the_number(simulate):
    few = simulate(seed=15, views=4)
    with pytest.raises(TargetError, match="in 4 views, at least 100 in 5 are needed"):
        intrinsics.calibrate(few.observations, 960, 600)


@pytest.mark.parametrize("seed", range(16, 20))
def test_views_straight_onto_the_target_do_not_show_the_focal_length(simulate, make_viewpoints, seed):
    straight = simulate(seed=seed, poses=lambda rng: make_viewpoints(rng, 12, tilt_deg=0.0), noise_px=0.3)
    with pytest.raises(Unobservable, match="focal length"):
        intrinsics.calibrate(straight.observations, 960, 600)


def test_pose_of_the_target_is_found_in_each_view(small):
    for observation, reported in zip(small.observations, small.reported, strict=True):
        found = intrinsics.camera_from_board(small.camera, observation)
        expected = pose.inverse(reported @ small.flange_from_camera) @ small.base_from_board
        distance, angle = pose.difference(found, expected)
        assert distance < 1e-3 and np.rad2deg(angle) < 0.5  # 0.1 px at f = 850 px over 0.3 m of board, and the arm's errors


def test_reprojection_is_the_model_of_the_refinement(small):
    state = small.state()
    session = small.session()
    first = session.some(session.view == 0)
    in_camera = camera_points(first, state)
    camera_from_board = pose.inverse(small.reported[0] @ small.flange_from_camera) @ small.base_from_board
    expected = projection.project(in_camera, state.intrinsics)[0]
    np.testing.assert_allclose(intrinsics.reproject(small.camera, camera_from_board, small.observations[0]), expected, atol=1e-9)


def test_coverage_counts_cells(small):
    one = replace(small.observations[0], pixels=np.array([[1.0, 1.0], [2.0, 2.0], [959.0, 599.0]]))
    assert intrinsics.coverage([one], 960, 600) == 2 / 64
