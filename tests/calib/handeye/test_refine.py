from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import KOALA, simulate
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import model, refine
from koala3d.calib.intrinsics import projection
from koala3d.calib.intrinsics.prior import IntrinsicsPrior
from koala3d.datasets import pose
from koala3d.datasets.targets.board import Board

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def disturbed(state, rng):
    """A start as far off as a closed form on a poor arm leaves it."""
    return replace(
        state,
        intrinsics=state.intrinsics + np.array([3, -3, 4, -4, 0.01, 0, 0, 0, 0, 0, 0, 0]),
        mount_from_camera=model.perturbed(state.mount_from_camera, rng.normal(0, 1, 6) * np.repeat([3e-3, 0.01], 3)),
        stand_from_board=model.perturbed(state.stand_from_board, rng.normal(0, 1, 6) * np.repeat([3e-3, 0.01], 3)),
    )


def test_perfect_measurements_give_the_truth(simulate):
    perfect = simulate(seed=1, views=12, noise_px=0, translation_m=0, rotation_deg=0)
    session = perfect.session(free=FREE, accuracy=model.Accuracy(1e-6, 1e-6))
    found = refine.refine(session, disturbed(perfect.state(), np.random.default_rng(0)), sigma_px=0.1)
    distance, angle = pose.difference(found.state.mount_from_camera, perfect.flange_from_camera)
    assert distance < 1e-8 and angle < 1e-8  # 0.01 micrometre: what a relative change of 1e-9 in the cost leaves
    np.testing.assert_allclose(found.state.intrinsics, projection.vector(perfect.camera), atol=1e-4)


def test_ordinary_session_is_within_the_aim_and_says_what_the_noise_was(simulate):
    ordinary = simulate(seed=2, views=25)
    found = refine.refine(ordinary.session(free=FREE), disturbed(ordinary.state(), np.random.default_rng(0)), sigma_px=0.3)
    distance, angle = pose.difference(found.state.mount_from_camera, ordinary.flange_from_camera)
    # 0.1 px, 0.05 mm, 0.01 deg and 25 views: in 80 sessions the median was 0.10 mm and 0.020 deg, the worst 0.28 and 0.046
    assert distance < 3e-4 and np.rad2deg(angle) < 0.05
    assert found.settled
    assert found.sigmas.pixel == pytest.approx(0.1, rel=0.06)  # 3500 residuals: 1.2 % one sigma
    assert found.sigmas.translation_m == pytest.approx(5e-5, rel=0.35)  # 75 - 12 of them: 9 %, rotation shares


def test_gross_corner_errors_are_left_out(simulate):
    spoilt = simulate(seed=4, views=15, outliers=3)
    found = refine.refine(spoilt.session(free=FREE), spoilt.state(), sigma_px=0.3)
    assert (~found.inliers).sum() == 45
    distance, angle = pose.difference(found.state.mount_from_camera, spoilt.flange_from_camera)
    assert distance < 2.5e-4 and np.rad2deg(angle) < 0.05


def test_plain_squares_where_the_residuals_look_gaussian_and_a_robust_loss_where_they_do_not(simulate):
    ordinary = simulate(seed=9, views=15)
    session = ordinary.session(free=FREE)
    assert refine.refine(session, ordinary.state(), sigma_px=0.3).sigmas.width == np.inf
    pixels = session.pixels.copy()
    pixels[::100] += [0.55, 0.0]  # 5.5 deviations: too little to be left out
    found = refine.refine(replace(session, pixels=pixels), ordinary.state(), sigma_px=0.3)
    assert found.sigmas.width == refine.HUBER and found.settled


def test_a_worse_arm_than_stated_is_noticed(simulate):
    poor = simulate(seed=5, views=25, translation_m=1e-3, rotation_deg=0.1)
    found = refine.refine(poor.session(free=FREE), poor.state(), sigma_px=0.3)
    # the stated accuracy counts as 4 views against 21: (1 - 12/75) of the truth and a sampling error of 8 %
    assert 0.7e-3 < found.sigmas.translation_m < 1.2e-3
    assert found.sigmas.pixel == pytest.approx(0.1, rel=0.06)


def test_known_intrinsics_are_kept_to(simulate):
    ordinary = simulate(seed=6, views=12)
    session = ordinary.session(
        free=("fx", "fy", "cx", "cy"), known=IntrinsicsPrior(("fx",), np.array([900.0]), np.array([[1e-12]]))
    )
    start = replace(ordinary.state(), intrinsics=ordinary.state().intrinsics + 50 * np.eye(12)[0])
    found = refine.refine(session, start, sigma_px=0.3)
    assert found.state.intrinsics[0] == pytest.approx(900.0, abs=1e-4)
    np.testing.assert_array_equal(found.state.intrinsics[4:], ordinary.state().intrinsics[4:])  # not free, not touched


def test_poses_of_other_pictures_are_refused(simulate):
    ordinary = simulate(seed=7, views=12)
    session = replace(ordinary.session(), base_from_flange=np.roll(ordinary.reported, 5, axis=0))
    with pytest.raises(CalibrationError, match=r"do not fit together|behind the camera"):
        refine.refine(session, ordinary.state(), sigma_px=0.1)


def test_a_solution_cut_short_says_so(simulate):
    poor = simulate(seed=5, views=25, translation_m=1e-3, rotation_deg=0.1)
    assert not refine.refine(poor.session(free=FREE), poor.state(), sigma_px=0.3, rounds=1).settled


def test_board_alone_is_found_again(small):
    start = replace(
        small.state(), stand_from_board=model.perturbed(small.base_from_board, np.array([0.01, -0.01, 0.02, 0.05, 0.02, -0.1]))
    )
    found = refine.fit_board(small.session(), start)
    distance, angle = pose.difference(found.stand_from_board, small.base_from_board)
    assert distance < 1e-4 and np.rad2deg(angle) < 0.02


def test_fifty_views_of_a_hundred_corners_take_a_few_steps():
    """What a step costs is the business of `python -m tests.bench.handeye`."""
    rig, rng = replace(KOALA, board=Board.of("charuco", 11, 11, 0.016, 0.0117, "DICT_5X5_100")), np.random.default_rng(8)
    drawn = simulate(rng, rig, viewpoints(rng, rig, 50, ViewRange()), sigma_px=0.1, arm=model.Accuracy(), free=FREE)
    assert len(drawn.session.view) == 50 * 100
    first = disturbed(replace(drawn.truth, corrections=np.zeros((50, 6))), rng)
    found = refine.refine(drawn.session, first, sigma_px=0.3)
    assert found.settled and found.steps <= 20  # 13 with this seed
    assert found.sigmas.pixel == pytest.approx(0.1, rel=0.05)
