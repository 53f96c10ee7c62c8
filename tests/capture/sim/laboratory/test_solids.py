import numpy as np
import pytest

from koala3d.capture.sim.laboratory.solids import carved, drum, ellipsoid, joined, rod, sphere

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-3, 3, (500, 3)).astype(np.float32)


def test_sphere_rod_and_round_ellipsoid_are_the_same_distance():
    wanted = np.linalg.norm(POINTS - [0.2, -0.1, 0.3], axis=1) - 0.8
    np.testing.assert_allclose(sphere(POINTS, (0.2, -0.1, 0.3), 0.8), wanted, atol=1e-5)
    np.testing.assert_allclose(ellipsoid(POINTS, (0.2, -0.1, 0.3), (0.8, 0.8, 0.8)), wanted, atol=1e-4)
    near = rod(POINTS, (0.2, -0.1, 0.3), (0.2, -0.1, 0.3001), 0.8, 0.8)
    np.testing.assert_allclose(near, wanted, atol=1e-3)


def test_drum_without_rounding_is_a_cylinder():
    points = np.array([[2, 0, 0], [0, 0, 1.5], [0, 0, 0], [1.0 + 3, 0, 0.5 + 4]], np.float32)
    np.testing.assert_allclose(drum(points, (0, 0, 0), 1.0, 0.5, 0.0), [1.0, 1.0, -0.5, 5.0], atol=1e-6)


@pytest.mark.parametrize("smooth", [0.01, 0.3, 1.0])
def test_joining_adds_at_most_a_quarter_of_the_fillet(smooth):
    first, second = sphere(POINTS, (0, 0, 0), 1.0), sphere(POINTS, (1, 0, 0), 0.7)
    plain, soft = np.minimum(first, second), joined(first, second, smooth)
    assert (soft <= plain + 1e-6).all() and (soft >= plain - smooth / 4 - 1e-6).all()


def test_carving_removes_the_tool():
    solid, tool = sphere(POINTS, (0, 0, 0), 2.0), sphere(POINTS, (1, 0, 0), 0.7)
    left = carved(solid, tool, 0.05)
    assert (left[tool < -0.1] > 0).all()
    np.testing.assert_allclose(left[tool > solid * -1 + 0.1], solid[tool > solid * -1 + 0.1], atol=0.02)
