from dataclasses import replace

import numpy as np
import pytest

from koala3d.calib.intrinsics import projection
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.spline import Grid, Spline

CAMERA = Camera(640, 480, 600.0, 590.0, 325.0, 236.0, -0.2, 0.08, 0.002, -0.003, -0.01)
POINTS = np.random.default_rng(0).uniform([-0.2, -0.15, 0.4], [0.2, 0.15, 0.8], (40, 3))
GRID = Grid(-0.7, -0.55, 0.2, 0.2, 8, 6)
SPLINE = Spline(GRID, tuple(np.random.default_rng(1).normal(0, 2e-3, 2 * GRID.count).tolist()))
FISHEYE = Camera(640, 480, 600.0, 590.0, 325.0, 236.0, 0.02, -0.01, k3=0.004, k4=-0.001, fisheye=True)
CAMERAS = {
    "ordinary": CAMERA,
    "splined": replace(CAMERA, spline=SPLINE),
    "fisheye": FISHEYE,
    "splined fisheye": replace(FISHEYE, spline=SPLINE),
}


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_projects_as_the_camera_does(camera):
    pixels, _, _ = projection.project(POINTS, projection.vector(camera), projection.form(camera))
    np.testing.assert_allclose(pixels, camera.project(POINTS), rtol=0, atol=1e-10)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_vector_and_camera_are_inverse(camera):
    zero = None if camera.spline is None else Spline(GRID, (0.0,) * len(SPLINE.knots))
    other = Camera(640, 480, 1.0, 1.0, 0.0, 0.0, fisheye=camera.fisheye, spline=zero)
    assert projection.with_vector(other, projection.vector(camera)) == camera


def test_names_lead_to_their_columns():
    names = (*projection.NAMES, *projection.knot_names(GRID))
    assert projection.columns(names) == list(range(12 + 2 * GRID.count))
    assert [name for name in names if not projection.is_knot(name)] == list(projection.NAMES)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_derivatives_agree_with_central_differences(camera):
    intrinsics, form = projection.vector(camera), projection.form(camera)
    _, by_point, by_intrinsics = projection.project(POINTS, intrinsics, form)
    assert by_intrinsics.shape == (len(POINTS), 2, len(intrinsics))
    step = 1e-6  # truncation about step^2, rounding about 1e-13 / step: both far below 1e-5 of a pixel per unit

    def numeric(move_points, move_intrinsics):
        ahead, behind = (projection.project(POINTS + s * move_points, intrinsics + s * move_intrinsics, form)[0] for s in (1, -1))
        return (ahead - behind) / (2 * step)

    for axis in range(3):
        np.testing.assert_allclose(by_point[..., axis], numeric(step * np.eye(3)[axis], 0), rtol=1e-6, atol=1e-4)
    for index, row in enumerate(step * np.eye(len(intrinsics))):
        np.testing.assert_allclose(by_intrinsics[..., index], numeric(0, row), rtol=1e-6, atol=1e-6)
