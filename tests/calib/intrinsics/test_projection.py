import numpy as np

from calib.intrinsics import projection
from datasets.camera_model import Camera

CAMERA = Camera(640, 480, 600.0, 590.0, 325.0, 236.0, -0.2, 0.08, 0.002, -0.003, -0.01)
POINTS = np.random.default_rng(0).uniform([-0.2, -0.15, 0.4], [0.2, 0.15, 0.8], (40, 3))


def test_projects_as_the_camera_does():
    pixels, _, _ = projection.project(POINTS, projection.vector(CAMERA))
    np.testing.assert_allclose(pixels, CAMERA.project(POINTS), rtol=0, atol=1e-10)


def test_vector_and_camera_are_inverse():
    other = Camera(640, 480, 1.0, 1.0, 0.0, 0.0)
    assert projection.with_vector(other, projection.vector(CAMERA)) == CAMERA


def test_derivatives_agree_with_central_differences():
    intrinsics = projection.vector(CAMERA)
    _, by_point, by_intrinsics = projection.project(POINTS, intrinsics)
    step = 1e-6  # truncation about step^2, rounding about 1e-13 / step: both far below 1e-5 of a pixel per unit
    for axis in range(3):
        move = step * np.eye(3)[axis]
        numeric = (projection.project(POINTS + move, intrinsics)[0] - projection.project(POINTS - move, intrinsics)[0]) / (
            2 * step
        )
        np.testing.assert_allclose(by_point[..., axis], numeric, rtol=1e-6, atol=1e-4)
    for index in range(12):
        move = step * np.eye(12)[index]
        numeric = (projection.project(POINTS, intrinsics + move)[0] - projection.project(POINTS, intrinsics - move)[0]) / (
            2 * step
        )
        np.testing.assert_allclose(by_intrinsics[..., index], numeric, rtol=1e-6, atol=1e-6)
