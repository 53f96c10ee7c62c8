"""Numbers of a pose in every layout; Euler angles against products of single turns by OpenCV."""

import cv2
import numpy as np
import pytest

from koala3d.calib.sessions.description import SEQUENCES, Description
from koala3d.calib.sessions.layouts import as_pose
from koala3d.datasets import pose
from koala3d.datasets.core.errors import KoalaError

MATRIX = pose.from_rotation_vector([2.0, -1.0, 0.4], [0.3, -0.2, 0.5])
LAYOUTS = ("x y z rx ry rz", "x y z qw qx qy qz", "x y z qx qy qz qw", "matrix", "matrix by columns")
ANGLES = np.array([170.0, -35.0, 62.0])


def described(**changes):
    board = {"type": "chessboard", "squares_x": 10, "squares_y": 7, "square_length_m": 0.02}
    plain = {"images": "*.png", "poses": "poses.csv", "layout": "x y z rx ry rz", "board": board}
    return Description(**{**plain, **changes})


def numbers(layout, matrix=MATRIX):
    quaternion = pose.quaternion(matrix)
    return {
        "x y z rx ry rz": [*matrix[:3, 3], *pose.rotation_vector(matrix)],
        "x y z qw qx qy qz": [*matrix[:3, 3], *quaternion],
        "x y z qx qy qz qw": [*matrix[:3, 3], *np.roll(quaternion, -1)],
        "matrix": matrix.ravel(),
        "matrix by columns": matrix.T.ravel(),
    }[layout]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_pose(layout):
    found = as_pose(numbers(layout), described(layout=layout), where="here")
    np.testing.assert_allclose(found, MATRIX, atol=1e-12)
    backwards = as_pose(numbers(layout, pose.inverse(MATRIX)), described(layout=layout, inverse=True), where="here")
    np.testing.assert_allclose(backwards, MATRIX, atol=1e-12)


def test_units_are_converted():
    values = np.array(numbers("x y z rx ry rz"))
    scaled = np.concatenate([1e3 * values[:3], np.rad2deg(values[3:])])
    np.testing.assert_allclose(as_pose(scaled, described(length="mm", angle="deg"), where="here"), MATRIX, atol=1e-12)
    upper = as_pose(MATRIX[:3].ravel(), described(layout="matrix"), where="here")
    np.testing.assert_allclose(upper, MATRIX, atol=1e-12)


@pytest.mark.parametrize(
    ("layout", "values", "message"),
    [
        ("x y z rx ry rz", [0.3, 0, 0, 170, 20, 5], "degrees.*angle: deg"),
        ("x y z rx ry rz", [300, 20, 500, 0.1, 0.2, 0.3], "millimetres.*length: mm"),
        ("x y z rx ry rz", [0, 0, 0, 1, 2], "5 numbers.*has 6"),
        ("x y z rx ry rz", [0, 0, float("nan"), 0, 0, 0], "not finite"),
        ("x y z qw qx qy qz", [0, 0, 0, 0.5, 0.5, 0.5, 0.7], "not of unit length"),
        ("matrix", MATRIX.T.ravel(), "layout: matrix by columns"),
        ("matrix by columns", MATRIX.ravel(), "layout: matrix$"),
        ("matrix", (MATRIX @ np.diag([1, 1, -1, 1])).ravel(), "left-handed"),
    ],
)
def test_numbers_that_betray_a_mistake_are_refused_in_one_line(layout, values, message):
    with pytest.raises(KoalaError, match=message) as error:
        as_pose(values, described(layout=layout), where="view 7")
    assert "view 7" in str(error.value) and "\n" not in str(error.value)


def turn(axis, degrees):
    """(3, 3) rotation about one axis, by OpenCV."""
    vector = np.zeros(3)
    vector["xyz".index(axis)] = np.deg2rad(degrees)
    return cv2.Rodrigues(vector)[0]


@pytest.mark.parametrize("euler", [sequence for sequence in SEQUENCES if sequence])
def test_euler_angles_are_turns_one_after_the_other(euler):
    first, second, third = (turn(axis, angle) for axis, angle in zip(euler.lower(), ANGLES, strict=True))
    expected = first @ second @ third if euler.isupper() else third @ second @ first
    found = as_pose(
        [300, -200, 500, *ANGLES], described(layout="x y z a b c", euler=euler, angle="deg", length="mm"), where="here"
    )
    np.testing.assert_allclose(found, pose.rigid(expected, [0.3, -0.2, 0.5]), atol=1e-12)
    radians = as_pose([0, 0, 0, *np.deg2rad(ANGLES)], described(layout="x y z rx ry rz", euler=euler), where="here")
    np.testing.assert_allclose(radians[:3, :3], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("layout", "euler", "formula"),
    [
        ("x y z a b c", "ZYX", lambda a, b, c: turn("z", a) @ turn("y", b) @ turn("x", c)),  # KUKA
        ("x y z w p r", "xyz", lambda w, p, r: turn("z", r) @ turn("y", p) @ turn("x", w)),  # FANUC
        ("x y z roll pitch yaw", "xyz", lambda r, p, y: turn("z", y) @ turn("y", p) @ turn("x", r)),  # xArm
        ("x y z a b c", "ZYZ", lambda a, b, c: turn("z", a) @ turn("y", b) @ turn("z", c)),  # Doosan, Kawasaki
        ("x y z rx ry rz", "XYZ", lambda a, b, c: turn("x", a) @ turn("y", b) @ turn("z", c)),  # Staubli
    ],
)
def test_makers_angles_are_read_by_their_own_formula(layout, euler, formula):
    found = as_pose([0, 0, 0, *ANGLES], described(layout=layout, euler=euler, angle="deg"), where="here")
    np.testing.assert_allclose(found[:3, :3], formula(*ANGLES), atol=1e-12)


def test_degrees_in_place_of_radians_are_noticed():
    with pytest.raises(KoalaError, match=r"Euler angle is longer than a full turn.*angle: deg"):
        as_pose([0, 0, 0, *ANGLES], described(layout="x y z a b c", euler="ZYX"), where="view 7")
