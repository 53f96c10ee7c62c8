import numpy as np
import pytest

from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import closed_forms
from koala3d.calib.intrinsics import estimate
from koala3d.datasets import pose


def boards(session):
    return estimate.camera_from_boards(session.camera, session.observations)


@pytest.mark.parametrize("method", closed_forms.METHODS)
def test_every_method_gives_the_truth_from_perfect_poses(simulate, method):
    perfect = simulate(seed=21, views=10, noise_px=0, translation_m=0, rotation_deg=0)
    truth = pose.inverse(perfect.reported @ perfect.flange_from_camera) @ perfect.base_from_board
    found = closed_forms.solve(perfect.reported, truth, method)
    np.testing.assert_allclose(found.mount_from_camera, perfect.flange_from_camera, atol=1e-6)
    np.testing.assert_allclose(found.stand_from_board, perfect.base_from_board, atol=1e-6)
    assert found.translation_residual_m.max() < 1e-6 and found.rotation_residual_rad.max() < 1e-6


def test_noise_leaves_what_it_should(simulate):
    ordinary = simulate(seed=22, views=20)
    found, keep = closed_forms.solve_robustly(ordinary.reported, boards(ordinary))
    distance, angle = pose.difference(found.mount_from_camera, ordinary.flange_from_camera)
    assert keep.all()
    assert distance < 1e-3 and np.rad2deg(angle) < 0.1  # a start for the refinement, five times its error


def test_a_view_taken_in_motion_is_found_and_left_out(simulate):
    ordinary = simulate(seed=23, views=15)
    reported = ordinary.reported.copy()
    reported[6] = pose.from_rotation_vector([0, 0.05, 0], [0.01, 0, 0.02]) @ reported[6]
    found, keep = closed_forms.solve_robustly(reported, boards(ordinary))
    assert np.flatnonzero(~keep).tolist() == [6]
    assert pose.difference(found.mount_from_camera, ordinary.flange_from_camera)[0] < 1e-3


def test_unknown_methods_and_too_few_views_are_refused(small):
    views = boards(small)
    with pytest.raises(CalibrationError, match="did you mean 'park'"):
        closed_forms.solve(small.reported, views, "parc")
    with pytest.raises(CalibrationError, match="at least 3 views"):
        closed_forms.solve(small.reported[:2], views[:2])
