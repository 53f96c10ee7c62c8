"""Hand-eye calibration of real arms, against answers that others have published for the same pictures."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from calib import handeye, intrinsics
from calib.calibrate import calibrate_handeye
from calib.report import notes
from calib.session import observe
from calib.targets import Board
from datasets import conventions, pose
from datasets.calibration import Calibration
from datasets.camera_model import Camera

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def folder(name):
    path = DATA / name
    if not path.is_dir():
        pytest.skip(f"the real session {path} is not there")
    return path


def opencv_camera(width, height, fx, fy, cx, cy, distortion=()):
    cx, cy = conventions.pixels_from_opencv([cx, cy])
    return Camera(width, height, fx, fy, float(cx), float(cy), *distortion)


@pytest.fixture(scope="module")
def visp():
    """(session, published camera) of the ViSP Franka session: 8 views of a chessboard with 9 x 6 inner corners."""
    path = folder("visp_franka_handeye") / "data-eye-in-hand"
    views = []
    for number in range(1, 9):
        values = np.ravel(yaml.safe_load((path / f"franka_pose_rPe_{number}.yaml").read_text())["data"])
        image = path / f"franka_image-{number}.png"
        views.append((str(number), image, pose.from_rotation_vector(values[3:], values[:3])))
    camera = opencv_camera(640, 480, 607.5931396484375, 607.574951171875, 323.46282958984375, 243.25529479980469)
    return observe(Board("chessboard", 10, 7, 0.0236), views), camera


@pytest.fixture(scope="module")
def charuco():
    """(session, published camera, published flange_from_camera) of the Franka ChArUco session: 12 views."""
    path = folder("franka_charuco_handeye")
    views = []
    for place in sorted(path.glob("pose_*")):
        content = json.loads((place / "data.json").read_text())
        views.append((place.name, place / "image.png", np.reshape(content["O_T_EE"], (4, 4))))  # row-major here
    matrix = content["camera_intrinsics"]
    camera = opencv_camera(1280, 720, matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2], content["dist_coeffs"])
    board = Board("charuco", 5, 7, 0.034, 0.028, "DICT_6X6_250")
    published = np.array(json.loads((path / "published_result.json").read_text())["T_cam_gripper"])
    return observe(board, views), camera, published


def closed_form(session, camera, method):
    boards = np.stack([intrinsics.camera_from_board(camera, o) for o in session.observations])
    return handeye.solve(session.base_from_flange, boards, method)


def test_park_gives_the_published_answer_for_visp(visp):
    session, camera = visp
    assert len(session.observations) == 8
    found = closed_form(session, camera, "park")
    # the source prints five digits of its own solver's answer; corners come from another detector: 0.2 mm
    np.testing.assert_allclose(found.flange_from_camera[:3, 3], [0.05772, -0.03392, -0.04228], atol=2e-4)


def test_charuco_agrees_with_the_published_answer(charuco):
    session, camera, published = charuco
    assert len(session.observations) == 12
    found = closed_form(session, camera, "park")
    # the source drew its axes into some corners: a fresh solve agrees within about 1 mm
    distance, angle = pose.difference(found.flange_from_camera, published)
    assert distance < 1.5e-3 and np.rad2deg(angle) < 0.3


def test_refinement_of_visp_stays_with_the_published_answer_and_admits_the_arm_errors(visp):
    session, camera = visp
    found = calibrate_handeye(session, Calibration(camera, {}))
    difference = 1e3 * (found.flange_from_camera.matrix[:3, 3] - [0.05772, -0.03392, -0.04228])
    # the arm's poses scatter by millimetres; both answers must agree within the stated uncertainty
    assert (np.abs(difference) < 2 * found.flange_from_camera.translation_std_mm).all()
    assert np.linalg.norm(difference) < 1.0
    assert found.residuals["arm_translation_mm"] > 1 and any("less accurate than stated" in note for note in notes(found))


def test_refinement_of_charuco_agrees_within_its_uncertainty(charuco):
    session, camera, published = charuco
    found = calibrate_handeye(session, Calibration(camera, {}))
    difference = 1e3 * (found.flange_from_camera.matrix[:3, 3] - published[:3, 3])
    assert (np.abs(difference) < 3 * found.flange_from_camera.translation_std_mm).all()
    assert np.linalg.norm(difference) < 2.0
    assert found.residuals["rms_px"] < 0.4  # the drawn axes spoil a few corners


def test_intrinsics_from_the_pictures_agree_with_the_maker_s(charuco):
    session, camera, _ = charuco
    found = intrinsics.calibrate(session.observations, session.width, session.height)
    # twelve views that cover a third of the image: within four deviations of the camera's own figures
    assert abs(found.camera.fx - camera.fx) < max(4 * found.std["fx"], 5) and abs(found.camera.cx - camera.cx) < max(
        4 * found.std["cx"], 8
    )


def test_axes_of_the_answer_are_a_camera_on_a_flange(visp):
    session, camera = visp
    found = closed_form(session, camera, "park")
    boards = session.base_from_flange @ found.flange_from_camera
    forward = boards[:, :3, 2]
    assert (forward[:, 2] < -0.5).all(), "the camera looks down at the table"
    assert found.translation_residual_m.mean() < 8e-3
