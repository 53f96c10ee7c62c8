"""Rotations that mean something else, in a file that no longer tells what; and arms that are merely poor."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.calib.calibrate import calibrate_handeye
from koala3d.calib.errors import CalibrationError
from koala3d.calib.handeye import credible
from koala3d.calib.handeye.model import Accuracy
from koala3d.calib.sessions.session import TargetSession
from koala3d.datasets import pose
from koala3d.datasets.residuals import Residuals


@pytest.mark.parametrize(("tilt_deg", "seed"), [(12, 0), (16, 2), (20, 0)])
def test_small_euler_angles_converted_as_a_rotation_vector_are_refused(simulate, make_viewpoints, tilt_deg, seed):
    """Rotations are one or two degrees wrong; the answer was 0.6 to 0.9 mm off, with a residual that shows nothing."""
    found = simulate(seed=seed, poses=lambda rng: make_viewpoints(rng, 20, tilt_deg=tilt_deg))
    apart = np.median([pose.rotation_angle(pose.inverse(one) @ found.reported) for one in found.reported], axis=1)
    true = pose.rigid(found.reported[apart.argmin()][:3, :3].T, [0, 0, 0]) @ found.reported
    angles = Rotation.from_matrix(true[:, :3, :3]).as_euler("xyz")
    read = pose.rigid(Rotation.from_rotvec(angles).as_matrix(), true[:, :3, 3])
    with pytest.raises(CalibrationError, match=r"rotations of the arm do not belong to its positions.*Euler angles"):
        calibrate_handeye(TargetSession(found.board, 960, 600, tuple(found.observations), read))
    calibrate_handeye(TargetSession(found.board, 960, 600, tuple(found.observations), true))


REAL = [(2.42, 0.216, 0.0, 8.3), (0.2, 0.01, 0.25, 19.1), (1.11, 0.235, 0.0, 5.9), (2.7, 0.3, 0.0, 7.9), (0.05, 0.01, 0.0, 0.3)]
"""Errors of positions [mm] and rotations [deg], share of corners left out and error on unseen views [px] of real sessions."""


def errors(translation_mm, rotation_deg, share=0.0, held_out_px: float | None = 1.0):
    return Residuals(
        arm_translation_mm=translation_mm,
        arm_rotation_deg=rotation_deg,
        corners=round(1000 * (1 - share)),
        corners_left_out=round(1000 * share),
        held_out_px=held_out_px,
    )


def test_real_arms_are_credible():
    for one in REAL:
        credible.check(errors(*one), Accuracy())
    credible.check(Residuals(), Accuracy())  # a camera alone


def test_one_more_sign_refuses_an_arm_whose_positions_are_poor_too():
    poor = (2.0, 1.5)
    credible.check(errors(*poor), Accuracy())
    with pytest.raises(CalibrationError, match="20% of the corners left out"):
        credible.check(errors(*poor, share=0.2), Accuracy())
    with pytest.raises(CalibrationError, match="unseen views not predictable"):
        credible.check(errors(*poor, held_out_px=None), Accuracy())
    credible.check(errors(*poor, share=0.2, held_out_px=None), Accuracy(rotation_rad=float(np.deg2rad(1))))  # stated
