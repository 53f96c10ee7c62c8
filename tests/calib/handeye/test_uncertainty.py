from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.advice import simulate as without_pictures
from koala3d.calib.advice.patterns import ViewRange, viewpoints
from koala3d.calib.advice.simulate import target_session
from koala3d.calib.errors import Unobservable
from koala3d.calib.handeye import refine, uncertainty
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.page import summary
from koala3d.datasets import pose

FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


def solved(simulated, free=FREE):
    session = simulated.session(free=free)
    return session, refine.refine(session, simulated.state(), sigma_px=0.2)


def error_twist(truth, stated):
    """(6,) twist of the perturbation in `truth = perturbation @ stated`."""
    perturbation = truth @ pose.inverse(stated)
    return np.concatenate([perturbation[:3, 3], pose.rotation_vector(perturbation)])


def test_errors_of_many_sessions_are_as_large_as_stated(simulate):
    sessions, squares = 64, {"flange_from_camera": [], "base_from_board": []}
    for seed in range(sessions):
        simulated = simulate(seed=500 + seed, views=12)
        session, refined = solved(simulated)
        found = uncertainty.poses(session, refined, uncertainty.covariance(session, refined))
        for (name, values), stated in zip(squares.items(), found, strict=True):
            error = error_twist(getattr(simulated, name), stated.matrix)
            values.append(error @ np.linalg.solve(stated.covariance, error))
    # chi-square with 6 degrees of freedom: mean 6, and its mean over 64 sessions has deviation sqrt(12 / 64) = 0.43;
    # the sigmas are estimated too, which adds up to 0.5: three deviations either side of that
    for values in squares.values():
        assert 4.7 < np.mean(values) < 7.8
    assert np.mean(np.array(squares["flange_from_camera"]) > 22.5) < 0.05  # the 99.9 % point


def test_position_deviation_is_that_of_the_position(small):
    session, refined = solved(small)
    _, board = uncertainty.poses(session, refined, uncertainty.covariance(session, refined))
    rng = np.random.default_rng(0)
    twists = rng.multivariate_normal(np.zeros(6), board.covariance, 4000)
    positions = np.array([(pose.from_rotation_vector(t[3:], t[:3]) @ board.matrix)[:3, 3] for t in twists])
    np.testing.assert_allclose(board.translation_std_mm, 1e3 * positions.std(0), rtol=0.05)  # 4000 draws: 1.1 % one sigma


def test_more_views_mean_less_uncertainty(simulate):
    def deviation(views):
        session, refined = solved(simulate(seed=31, views=views))
        return uncertainty.poses(session, refined, uncertainty.covariance(session, refined))[0].translation_std_mm.mean()

    assert deviation(40) < 0.75 * deviation(12)  # sqrt(12 / 40) = 0.55


def test_pure_translation_is_refused(simulate, make_viewpoints):
    still = simulate(poses=lambda rng: make_viewpoints(rng, 12, tilt_deg=0.0, turn=False))
    with pytest.raises(Unobservable, match="translation of the hand-eye pose is not observable"):
        uncertainty.check_motion(still.reported)


def test_one_axis_of_rotation_is_refused_and_named(simulate, make_viewpoints):
    hinged = simulate(poses=lambda rng: make_viewpoints(rng, 12, axis=0.0, turn=False))
    with pytest.raises(Unobservable, match=r"along the axis of rotation.*\(1\.00, -?0\.00, -?0\.00\) in the base"):
        uncertainty.check_motion(hinged.reported)


def test_two_views_are_refused(small):
    with pytest.raises(Unobservable, match="2 views"):
        uncertainty.check_motion(small.reported[:2])


@pytest.mark.parametrize(("tilt_deg", "refused"), [(2.5, True), (2.7, False)], ids=["too little", "enough"])
def test_the_line_between_weak_and_ordinary_motion_is_at_three_degrees(tilt_deg, refused):
    """Four views tilted to four sides: about each axis they differ by sqrt(8 / 6) tilts rms, 2.9 and 3.1 degrees."""
    tilts = np.deg2rad(tilt_deg) * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    views = pose.from_rotation_vector(tilts, np.zeros((4, 3)))
    if refused:
        with pytest.raises(Unobservable, match="not observable"):
            uncertainty.check_motion(views)
    else:
        uncertainty.check_motion(views)


def test_ordinary_motion_passes_and_determines_the_rig(simulate):
    """What the motion check lets through is known to a fraction of a millimetre; what it refuses is not (see below)."""
    ordinary = simulate(seed=33, views=12)
    uncertainty.check_motion(ordinary.reported)
    session, refined = solved(ordinary)
    flange_from_camera, _ = uncertainty.poses(session, refined, uncertainty.covariance(session, refined))
    assert flange_from_camera.translation_std_mm.max() < 0.3 and flange_from_camera.rotation_std_deg.max() < 0.05


@pytest.mark.parametrize(
    "options", [{"axis": 0.0, "turn": False}, {"tilt_deg": 0.0, "turn": False}], ids=["one axis", "no rotation"]
)
def test_information_shows_what_the_motion_check_would_have_caught(simulate, make_viewpoints, options):
    weak = simulate(seed=32, poses=lambda rng: make_viewpoints(rng, 12, **options))
    session, refined = solved(weak, free=("fx",))
    with pytest.raises(Unobservable, match=r"translation . is not observable"):
        uncertainty.covariance(session, refined)


def test_parameter_without_any_information_is_named(small):
    session, refined = solved(small)
    information = refined.information.copy()
    information[3, :] = information[:, 3] = 0.0
    with pytest.raises(Unobservable, match="cy is not observable"):
        uncertainty.covariance(session, replace(refined, information=information))


def test_names_follow_the_order_of_the_information(small):
    session, refined = solved(small, free=("fx", "k1"))
    names = uncertainty.parameter_names(session)
    assert len(names) == len(refined.information)
    assert names[:3] == ["fx", "k1", "flange_from_camera translation x"] and names[-1] == "base_from_board rotation z"


def test_a_relaxed_bound_accepts_a_poor_arm_and_marks_the_calibration():
    arm = Accuracy(0.01, float(np.deg2rad(0.5)))
    rng = np.random.default_rng(0)
    rig = without_pictures.KOALA
    views = viewpoints(rng, rig, 8, ViewRange((20.0, 50.0)))
    session = target_session(without_pictures.simulate(rng, rig, views, sigma_px=0.2, arm=arm))
    with pytest.raises(Unobservable, match=r"6.7 mm.*--allow-mm accepts more"):
        calibrate.calibrate_handeye(session, accuracy=arm)
    with pytest.raises(Unobservable, match=r"6\.7 mm"):
        calibrate.calibrate_handeye(session, accuracy=arm, allow_m=6e-3)
    found = calibrate.calibrate_handeye(session, accuracy=arm, allow_m=0.02)
    assert found.residuals.allowed_mm == 20.0 and found.flange_from_camera is not None
    assert 5.0 < found.flange_from_camera.translation_std_mm.max() < 20.0
    said = summary.describe_calibration(found)
    assert "flange_from_camera (bound relaxed)" in said and "relaxed from 5 to 20 mm by --allow-mm; 7.3 mm is above it" in said
