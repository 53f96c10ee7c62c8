from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from koala3d.datasets.camera_model import Camera
from koala3d.datasets.conventions import pixels_from_opencv
from koala3d.datasets.core.errors import DatasetError


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


cameras = st.builds(
    Camera,
    width=st.just(640),
    height=st.just(480),
    fx=between(550, 900),
    fy=between(550, 900),
    cx=between(280, 360),
    cy=between(200, 280),
    k1=between(-0.12, 0.2),
    k2=between(-0.02, 0.05),
    p1=between(-2e-3, 2e-3),
    p2=between(-2e-3, 2e-3),
    k3=between(-0.005, 0.01),
)
"""Lenses that do not fold within their picture: its corner lies at most 0.83 from the axis, the worst of these folds at 0.93."""
pixels = st.tuples(between(0, 640), between(0, 480))


@given(cameras, pixels)
def test_project_inverts_directions(camera: Camera, pixel: tuple[float, float]) -> None:
    ray = camera.directions(pixel)
    assert ray[2] == 1.0
    assert np.abs(camera.project(2.5 * ray) - pixel).max() < 1e-7  # Newton's end, times a focal length


@given(cameras, st.tuples(between(-0.5, 0.5), between(-0.4, 0.4)))
def test_undistort_inverts_distort(camera: Camera, point: tuple[float, float]) -> None:
    assert np.abs(camera.undistort(camera.distort(point)) - point).max() < 1e-9


@given(cameras, pixels, st.integers(1, 2000), st.integers(1, 2000))
def test_scaling_is_exact(camera: Camera, pixel: tuple[float, float], width: int, height: int) -> None:
    """The same ray meets the same spot of the picture, whatever the picture's resolution."""
    small = camera.scaled(width, height)
    moved = np.array(pixel) * [width / 640, height / 480]
    assert np.abs(small.directions(moved) - camera.directions(pixel)).max() < 1e-9


@given(cameras, st.tuples(between(-0.5, 0.5), between(-0.4, 0.4), between(0.5, 3)))
def test_projection_is_opencvs_half_a_pixel_away(camera: Camera, point: tuple[float, float, float]) -> None:
    """OpenCV puts the first pixel's centre at (0, 0): its principal point is half a pixel less than ours."""
    opencv_matrix = replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5).matrix
    theirs, _ = cv2.projectPoints(np.array([point]), np.zeros(3), np.zeros(3), opencv_matrix, camera.distortion)
    assert np.abs(camera.project(point) - pixels_from_opencv(theirs[0, 0])).max() < 1e-7


def test_pixel_centres_start_at_half() -> None:
    centres = Camera(3, 2, 1, 1, 1, 1).pixel_centres()
    assert centres.shape == (2, 3, 2)
    assert centres[0, 0].tolist() == [0.5, 0.5] and centres[1, 2].tolist() == [2.5, 1.5]


def test_centred_means_pinhole_square_and_in_the_middle() -> None:
    centred = Camera(640, 480, 500, 500, 320, 240)
    assert centred.is_centred
    assert not any(replace(centred, **change).is_centred for change in ({"fy": 501.0}, {"cx": 321.0}, {"k1": 1e-9}))


@given(cameras)
def test_json_round_trip_is_exact(camera: Camera) -> None:
    assert Camera.from_json(camera.to_json(), where="here") == camera


@pytest.mark.parametrize("change", [{"fx": np.nan}, {"fx": 0.0}, {"width": 0}, {"fx": "wide"}, {"zoom": 2}, {"width": np.inf}])
def test_impossible_cameras_are_refused(change: dict) -> None:
    good = Camera(640, 480, 500, 500, 320, 240).to_json()
    with pytest.raises(DatasetError, match="here"):
        Camera.from_json(good | change, where="here")


RATIONAL = Camera(640, 480, 500.0, 505.0, 322.0, 236.0, 0.35, -0.08, 1e-3, -5e-4, 0.02, 0.5, -0.03, 0.01)
FISHEYE = Camera(640, 480, 300.0, 301.0, 322.0, 236.0, 0.02, -0.01, k3=0.004, k4=-0.001, fisheye=True)
POINTS = np.random.default_rng(0).uniform([-0.6, -0.5, 0.9], [0.6, 0.5, 1.1], (50, 3))


@pytest.mark.parametrize("camera", [RATIONAL, FISHEYE], ids=["rational", "fisheye"])
def test_rational_and_fisheye_lenses_are_opencvs(camera: Camera) -> None:
    matrix = replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5).matrix
    if camera.fisheye:
        fisheye = np.array([camera.k1, camera.k2, camera.k3, camera.k4])
        theirs, _ = cv2.fisheye.projectPoints(POINTS[:, None], np.zeros(3), np.zeros(3), matrix, fisheye)
    else:
        theirs, _ = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), matrix, camera.distortion)
    np.testing.assert_allclose(camera.project(POINTS), pixels_from_opencv(theirs[:, 0]), atol=1e-9)


@pytest.mark.parametrize("camera", [RATIONAL, FISHEYE], ids=["rational", "fisheye"])
def test_rational_and_fisheye_lenses_can_be_inverted_and_stored(camera: Camera) -> None:
    normalised = POINTS[:, :2] * (4 if camera.fisheye else 1)  # the fisheye also at 70 degrees off its axis
    np.testing.assert_allclose(camera.undistort(camera.distort(normalised)), normalised, atol=1e-9)
    assert Camera.from_json(camera.to_json(), where="test") == camera
    assert not camera.is_pinhole and camera.undistorted().is_pinhole


def test_a_fisheye_is_smooth_on_its_axis() -> None:
    r2 = np.array([0.0, 0.9e-8, 1.1e-8, 1e-4])
    radial, slope = FISHEYE.radial(r2)
    np.testing.assert_allclose(radial, 1 + (FISHEYE.k1 - 1 / 3) * r2, atol=1e-8)
    np.testing.assert_allclose(slope, FISHEYE.k1 - 1 / 3, atol=1e-3)


def test_plain_lenses_are_stored_without_rational_terms() -> None:
    assert set(Camera(2, 2, 1, 1, 1, 1).to_json()) == {"width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}


def test_pixels_beyond_the_range_of_a_lens_are_not_valid() -> None:
    """OpenCV's own distortion, inverted where it still grows with the radius: r (1 - 0.6 r^2) ends at r = 0.745."""
    camera = Camera(64, 48, 60, 60, 32, 24, k1=-0.6)
    radius = np.linspace(0, 1.2, 20_000)
    points = np.stack([radius, 0 * radius, 0 * radius + 1], -1)
    bent = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array([-0.6, 0, 0, 0]))[0].reshape(-1, 2)[:, 0]
    furthest = bent.max()
    columns = np.arange(64) + 0.5
    expected = np.abs(columns - 32) / 60 < furthest
    assert np.array_equal(camera.valid(np.stack([columns, 0 * columns + 24], -1)), expected)
    right = camera.directions([[columns[expected][-1], 24.0]])[0]
    assert right[0] == pytest.approx(
        np.interp((columns[expected][-1] - 32) / 60, bent[: bent.argmax()], radius[: bent.argmax()]), abs=1e-6
    )
    valid = camera.valid_pixels()
    assert valid is not None and valid[24].tolist() == expected.tolist()
    assert replace(camera, k1=-0.1).valid_pixels() is None


def test_a_fisheye_has_no_rays_beyond_a_right_angle() -> None:
    """Equidistant: OpenCV's fisheye without coefficients has the angle times the focal length."""
    camera = Camera(600, 600, 180, 180, 300, 300, fisheye=True)
    columns, rows = np.meshgrid(np.arange(600) + 0.5, np.arange(600) + 0.5)
    angle = np.hypot(columns - 300, rows - 300) / 180
    valid = camera.valid_pixels()
    assert valid is not None
    assert valid[angle < np.deg2rad(88.9)].all() and not valid[angle > np.deg2rad(89.1)].any()
    rays = camera.directions(np.stack([columns, rows], -1)[valid])
    found = np.arctan(np.linalg.norm(rays[:, :2], axis=1))
    assert np.abs(found - angle[valid]).max() < 1e-9
