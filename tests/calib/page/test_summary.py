from dataclasses import replace

import numpy as np

from koala3d.calib.handeye.verify import Verification
from koala3d.calib.page import summary
from koala3d.datasets import pose
from koala3d.datasets.calibration import Calibration, UncertainPose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.residuals import Residuals

RESIDUALS = Residuals(
    rms_px=0.1,
    held_out_px=0.2,
    held_out_mm=0.15,
    corners=900,
    views_used=20,
    coverage=0.5,
    arm_translation_mm=0.05,
    arm_rotation_deg=0.01,
)
CALIBRATION = Calibration(
    Camera(640, 480, 600.0, 601.0, 320.0, 240.0, -0.1),
    {"fx": 0.5, "fy": 0.5, "cx": 0.2, "cy": 0.2, "k1": 0.001},
    UncertainPose(pose.from_rotation_vector([0, 0, np.pi / 2], [0.01, 0, 0]), np.diag([1e-10] * 3 + [0.0] * 3)),
    residuals=RESIDUALS,
    provenance={"arm_accuracy_stated": {"translation_mm": 0.05, "rotation_deg": 0.01}},
)


def test_summary_has_values_with_deviations_and_units():
    text = summary.describe_calibration(CALIBRATION)
    assert "10.000 ± 0.010, 0.000 ± 0.010, 0.000 ± 0.010 mm" in text
    assert "0.0000, 0.0000, 90.0000 deg" in text
    assert "600.00 ± 0.50 px" in text and "-0.10000 ± 0.00100" in text
    assert "base_from_board" not in text and "note:" not in text


def test_intrinsics_alone_need_no_arm():
    residuals = replace(RESIDUALS, arm_translation_mm=None, arm_rotation_deg=None, held_out_mm=None)
    text = summary.describe_calibration(replace(CALIBRATION, flange_from_camera=None, residuals=residuals, provenance={}))
    assert "arm errors" not in text and "0.200 px" in text


def test_notes_name_what_a_person_should_look_at():
    residuals = replace(
        RESIDUALS, views_unseen=["003"], views_left_out=["007"], coverage=0.2, arm_translation_mm=1.0, settled=False
    )
    text = "\n".join(summary.notes(replace(CALIBRATION, residuals=residuals)))
    assert "view 003" in text and "view 007" in text and "little of the image" in text and "20 times less accurate" in text
    assert "the arm's positions" in text and "the arm's rotations" not in text
    assert "did not converge" in text


def test_notes_name_signs_of_poses_that_are_wrong():
    """What a calibration from small Euler angles read as rotation vectors had: 150 times the stated error of a rotation."""
    residuals = replace(RESIDUALS, arm_rotation_deg=1.49, corners=810, corners_left_out=139, held_out_px=None)
    text = "\n".join(summary.notes(replace(CALIBRATION, residuals=residuals)))
    assert "the arm's rotations are 149 times less accurate than stated (0.01 deg)" in text
    assert "15% of the corners are left out" in text and "there is no error on unseen views" in text
    assert summary.notes(CALIBRATION) == []


def test_the_flange_of_an_imported_session_may_be_a_tool():
    imported = replace(CALIBRATION, provenance={**CALIBRATION.provenance, "folder": "/data/session"})
    assert "tool centre point (TCP)" in summary.describe_calibration(imported)
    assert "TCP" not in summary.describe_calibration(CALIBRATION)


def test_verification_names_the_worst_view():
    text = summary.describe_verification(Verification(0.3, 0.2, {"000": 0.1, "001": 0.5}, 80, "base", np.eye(4)))
    assert "0.300 px = 0.200 mm" in text and "001: 0.500 px" in text


def test_error_with_every_corner_is_shown_where_corners_were_left_out():
    more = replace(RESIDUALS, held_out_all_px=0.5, held_out_all_mm=0.4, corners_left_out=7)
    assert "with every corner 0.500 px = 0.400 mm, the 7 that were left out" in summary.describe_calibration(
        replace(CALIBRATION, residuals=more)
    )
    none = replace(more, corners_left_out=0)
    assert "every corner" not in summary.describe_calibration(replace(CALIBRATION, residuals=none))
