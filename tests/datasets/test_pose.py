import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.datasets import pose
from koala3d.datasets.core.errors import DatasetError

numbers = st.floats(-3, 3, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers)
poses = st.builds(pose.from_rotation_vector, vectors, vectors)
EXACT = 1e-12  # float64 algebra on numbers of order 1


@given(poses)
def test_inverse_of_inverse_and_product_with_inverse(a_from_b: np.ndarray) -> None:
    assert np.abs(pose.inverse(pose.inverse(a_from_b)) - a_from_b).max() < EXACT
    assert np.abs(a_from_b @ pose.inverse(a_from_b) - np.eye(4)).max() < EXACT


@given(vectors, vectors)
def test_rotation_vector_round_trip_up_to_a_full_turn(vector: tuple, translation: tuple) -> None:
    matrix = pose.from_rotation_vector(vector, translation)
    again = pose.from_rotation_vector(pose.rotation_vector(matrix), matrix[:3, 3])
    assert np.abs(again - matrix).max() < 1e-9  # near pi the axis is the root of a small number
    assert pose.rotation_angle(matrix) <= np.pi + EXACT


@given(poses)
def test_quaternion_is_wxyz_and_comes_back(matrix: np.ndarray) -> None:
    wxyz = pose.quaternion(matrix)
    assert wxyz[0] >= 0 and abs(np.linalg.norm(wxyz) - 1) < EXACT
    assert np.abs(pose.from_quaternion(wxyz, matrix[:3, 3]) - matrix).max() < EXACT


def test_quaternion_order_by_hand() -> None:
    """A quarter turn about z: w = z = sqrt(1/2); x goes to y."""
    matrix = pose.from_quaternion([np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    assert np.allclose(matrix[:3, :3] @ [1, 0, 0], [0, 1, 0])


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 1.0, np.pi - 1e-7, np.pi])
def test_angle_is_accurate_near_zero_and_pi(angle: float) -> None:
    assert pose.rotation_angle(pose.from_rotation_vector((0.6 * angle, 0, 0.8 * angle))) == pytest.approx(angle, rel=1e-6)


@given(vectors)
def test_look_at_sees_the_target_on_its_axis(position: tuple) -> None:
    if np.linalg.norm(position) < 1e-6:
        return
    world_from_camera = pose.look_at(position, (0, 0, 0))
    target = pose.inverse(world_from_camera) @ [0, 0, 0, 1]
    assert np.abs(target[:2]).max() < 1e-9 and target[2] > 0
    assert np.linalg.det(world_from_camera[:3, :3]) == pytest.approx(1)
    assert world_from_camera[2, 1] <= 1e-9  # y points down


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1, -1, 1]), "left-handed"),
        (np.diag([2.0, 2, 2, 1]), "away from orthonormal"),
        (np.eye(3), "not 4x4"),
        ("abc", "not a matrix"),
    ],
)
def test_impossible_poses_are_refused(bad: object, words: str) -> None:
    with pytest.raises(DatasetError, match=words):
        pose.checked(bad, where="frame 3")


@given(poses)
def test_checked_corrects_rounding_only(matrix: np.ndarray) -> None:
    rounded = pose.checked(matrix.round(6), where="here")
    assert np.abs(rounded - matrix).max() < 1e-5
    assert np.abs(rounded[:3, :3] @ rounded[:3, :3].T - np.eye(3)).max() < EXACT


@given(vectors, vectors)
def test_cross_is_the_matrix_of_the_cross_product(a: tuple, b: tuple) -> None:
    assert np.abs(pose.cross(a) @ b - np.cross(a, b)).max() < EXACT
    assert pose.cross([a, b]).shape == (2, 3, 3) and np.array_equal(pose.cross([a, b])[1], pose.cross(b))
