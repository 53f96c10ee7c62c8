import numpy as np
import pytest

from koala3d.calib.solver import geometry
from koala3d.datasets import pose


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.99e-4, 1.01e-4, 1.0, 3.0])
def test_exponential_is_a_rotation_near_zero_and_far(angle):
    vector = angle * np.array([[0.6, -0.48, 0.64]])
    rotation, right = geometry.exponential(vector)
    np.testing.assert_allclose(rotation[0], pose.from_rotation_vector(vector[0])[:3, :3], atol=1e-14)
    np.testing.assert_allclose(right @ vector[0], vector, atol=1e-14)  # the axis is left alone


def test_rotate_and_rows_cross_are_what_they_say():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 5, 3))
    turns = pose.from_rotation_vector(a)[:, :3, :3]
    np.testing.assert_allclose(geometry.rotate(turns, b)[3], turns[3] @ b[3], atol=1e-14)
    rows = rng.normal(size=(5, 2, 3))
    np.testing.assert_allclose(geometry.rows_cross(rows, a), rows @ pose.cross(a), atol=1e-14)
