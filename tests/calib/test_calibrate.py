from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib import calibrate
from koala3d.calib.errors import TargetError, Unobservable
from koala3d.calib.handeye import verify
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration
from koala3d.datasets.core.errors import UsageError


def target_session(simulated, name="a"):
    """A simulated session as if its pictures had been searched."""
    return TargetSession(
        simulated.board,
        simulated.camera.width,
        simulated.camera.height,
        tuple(simulated.observations),
        simulated.reported,
        provenance={"frames_sha256": name},
    )


def errors(found, truth):
    """(mm, deg) of the hand-eye pose."""
    distance, angle = pose.difference(found.flange_from_camera.matrix, truth.flange_from_camera)
    return 1e3 * distance, np.rad2deg(angle)


def test_pictures_give_the_rig(recorded, calibrated):
    found = calibrated
    millimetres, degrees = errors(found, recorded[1])
    # half the resolution of the demo and 11 views; the arm alone (0.05 mm, 0.01 deg) leaves about 0.05 mm and 0.01 deg
    assert millimetres < 0.25 and degrees < 0.05
    assert found.residuals.views_used == 11 and found.residuals.views_unseen == ["011"]
    assert found.residuals.rms_px < 0.1


def test_calibration_survives_its_file(simulate, tmp_path):
    found = calibrate.calibrate_handeye(target_session(simulate(seed=41, views=12)))
    found.save(tmp_path / "calibration.json")
    again = Calibration.load(tmp_path / "calibration.json")
    assert again.camera == found.camera and again.camera_std == found.camera_std
    np.testing.assert_allclose(again.flange_from_camera.matrix, found.flange_from_camera.matrix, atol=1e-12)
    assert again.residuals == found.residuals


def test_intrinsics_from_another_session_enter_with_their_deviations(simulate):
    weak, strong = simulate(seed=42, views=8), simulate(seed=43, views=40)
    given = calibrate.calibrate_intrinsics(target_session(strong, "strong"))
    alone = calibrate.calibrate_handeye(target_session(weak, "weak"))
    helped = calibrate.calibrate_handeye(target_session(weak, "weak"), given)
    assert helped.camera_std["cx"] < 0.8 * alone.camera_std["cx"]
    assert abs(helped.camera.cx - weak.camera.cx) < 4 * helped.camera_std["cx"]
    assert (helped.flange_from_camera.rotation_std_deg < alone.flange_from_camera.rotation_std_deg).all()


def test_intrinsics_from_the_same_session_do_not_count_twice(simulate):
    session = target_session(simulate(seed=44, views=12))
    given = calibrate.calibrate_intrinsics(session)
    alone, helped = calibrate.calibrate_handeye(session), calibrate.calibrate_handeye(session, given)
    assert helped.camera_std["cx"] == pytest.approx(alone.camera_std["cx"], rel=0.02)


def test_given_intrinsics_without_deviations_stay(simulate):
    simulated = simulate(seed=45, views=12)
    found = calibrate.calibrate_handeye(target_session(simulated), Calibration(simulated.camera, {}))
    assert found.camera == simulated.camera and found.camera_std == {}
    assert errors(found, simulated)[0] < 0.3


def test_given_intrinsics_of_another_size_are_refused(simulate):
    simulated = simulate(seed=45, views=12)
    with pytest.raises(UsageError, match="480x300, the recording has 960x600"):
        calibrate.calibrate_handeye(target_session(simulated), Calibration(simulated.camera.scaled(480, 300), {}))


def test_a_view_that_disagrees_is_left_out_and_named(simulate):
    simulated = simulate(seed=46, views=15)
    reported = simulated.reported.copy()
    reported[4, :3, 3] += [0.01, 0.0, 0.0]
    found = calibrate.calibrate_handeye(target_session(replace(simulated, reported=reported)))
    assert found.residuals.views_left_out == ["004"] and found.residuals.views_used == 14
    assert errors(found, simulated)[0] < 0.4


def test_weak_motion_and_too_few_views_are_refused(simulate, make_viewpoints):
    hinged = simulate(poses=lambda rng: make_viewpoints(rng, 12, axis=0.5, turn=False))
    with pytest.raises(Unobservable, match="axis of rotation"):
        calibrate.calibrate_handeye(target_session(hinged))
    with pytest.raises(TargetError, match="not seen often enough"):
        calibrate.calibrate_handeye(target_session(simulate(views=3)))


def test_held_out_error_is_that_of_the_arm(simulate):
    poor = simulate(seed=47, views=25, translation_m=5e-4, rotation_deg=0.0)
    found = calibrate.calibrate_handeye(target_session(poor), accuracy=Accuracy(5e-4, 1e-5))
    # 0.5 mm per axis, two axes across the line of sight: 0.71 mm, a tenth more since 20 views fit the rest
    assert 0.5 < found.residuals.held_out_mm < 1.0
    assert found.residuals.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)


def test_verification_sees_a_hand_eye_error(simulate):
    simulated, other = simulate(seed=48, views=20), simulate(seed=49, views=15)
    found = calibrate.calibrate_handeye(target_session(simulated))
    right = verify.verify(target_session(other), found)
    assert right.rms_mm < 0.2 and len(right.view_rms_px) == 15
    moved = found.flange_from_camera.matrix @ pose.from_rotation_vector([0, 0, 0], [0.002, 0, 0])
    wrong = verify.verify(
        target_session(other), replace(found, flange_from_camera=replace(found.flange_from_camera, matrix=moved))
    )
    assert wrong.rms_mm > 3 * right.rms_mm
    distance, _ = pose.difference(right.stand_from_board, other.base_from_board)
    assert distance < 3e-4


def test_verification_needs_a_hand_eye_pose_and_the_right_size(simulate):
    session = target_session(simulate(seed=48, views=8))
    with pytest.raises(UsageError, match="holds no hand-eye pose"):
        verify.verify(session, Calibration(simulate(seed=48, views=8).camera, {}))
